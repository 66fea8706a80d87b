// SPDX-License-Identifier: BSD-3-Clause
#include "core/robust/crowd.h"

#include <algorithm>
#include <numeric>
#include <utility>
#include <vector>

#include "core/constants.h"
#include "core/pose.h"
#include "core/robust/inliers.h"
#include "core/robust/neighbourhoods.h"
#include "core/robust/random.h"

namespace epi360 {
namespace {

// Times that the share of the inliers among the matches may be that of their regions. Of right
// poses of rendered and photographed rooms one in thirty has more, of wrong ones one in five.
constexpr double kCrowd = 1.8;
constexpr double kSamePose = 10.0 * kDegree;
// What a search of so few samples finds by chance explains a sixth of the regions; motions that are
// there, beside a tram, 0.4 and more.
constexpr double kLeastOfRegions = 0.3;
constexpr std::size_t kMostAsked = 4000;  // matches of which regions are made
constexpr int kMostOfRegions = 400;       // samples

}  // namespace

bool inliers_crowd(const Evidence& e) {
  return e.support * e.all_regions > kCrowd * e.num_regions * e.num_effective;
}

MatchesLeft one_for_each_region(const Matches& m, const MatchPriors& priors, std::uint64_t seed) {
  if (m.size <= kMostAsked) return only(m, priors, one_of_each_region(m));
  Random random(seed);
  std::vector<std::size_t> asked(m.size);
  std::iota(asked.begin(), asked.end(), std::size_t{0});
  random.choose(asked, 0, kMostAsked);
  asked.resize(kMostAsked);
  std::sort(asked.begin(), asked.end());
  std::vector<std::size_t> rows = one_of_each_region(chosen_matches(m, asked));
  for (std::size_t& row : rows) row = asked[row];
  return only(m, priors, std::move(rows));
}

RobustOptions options_of_regions(const RobustOptions& options) {
  return with_most_samples(options, kMostOfRegions);
}

bool regions_contradict(const Matches& few, Residual residual, const RobustResult& regions,
                        const RobustResult& all) {
  const double least = kLeastOfRegions * static_cast<double>(few.size);
  const Status status = judge(regions.evidence).status;
  if (status == Status::kPureRotation) return regions.evidence.rotation_support >= least;
  if (!has_translation(status) || regions.evidence.support < least) return false;
  std::vector<unsigned char> inlier;
  std::vector<double> residuals;
  const double support =
      mark_inliers(few, residual, all.cam2_from_cam1, regions.threshold, true, inlier, residuals);
  return regions.evidence.support > support &&
         !same_pose(regions.cam2_from_cam1, all.cam2_from_cam1, kSamePose, kSamePose);
}

}  // namespace epi360
