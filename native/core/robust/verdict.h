// SPDX-License-Identifier: BSD-3-Clause
// Every rule that makes a status or a warning: evidence in, verdict out, nothing else.
#pragma once

#include <limits>
#include <vector>

namespace epi360 {

enum class Status {
  kOk,
  kTooFewMatches,
  kTooFewInliers,
  kPureRotation,
  kPlanarAmbiguous,
  kConcentratedInliers,
};

enum class WarningCode {
  kMissingMatches,
  kLittleParallax,
  kPartialCoverage,
  kMuchNoise,
  kMirrored,
  kMirroredTurn,
  kAgainstGravity,
  kDisplaced,
  kCopies,
  kMotionBeside,
  kOneSide,
  kOnlyCrowd,
  kFixedContent
};

// The names that a user sees.
const char* name_of(Status status);
const char* name_of(WarningCode code);

// A warning and the two numbers that it compares: missing matches of all; parallax and noise;
// coverage by inliers and by all matches; noise and its limit; matches behind a camera and inliers;
// matches of a mirrored turn and inliers; tilt against gravity and its standard deviation; matches
// that a rotation leaves displaced and those that it explains; copies that were left out of all;
// matches of a motion and those that stand still beside it; matches on one side that say another
// motion, and inliers of the others; inliers that crowd, and regions that agree with them; matches
// that are fixed to the camera of all.
struct Warning {
  WarningCode code;
  double value, reference;
};

struct Verdict {
  Status status = Status::kOk;
  std::vector<Warning> warnings;
};

// What speaks for and against a pose. Evidence comes in step by step; what is not known yet speaks
// for the pose. Angles in radians.
struct Evidence {
  static constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
  static constexpr double kInfinity = std::numeric_limits<double>::infinity();

  // The matches: rows given, copies of others and matches fixed to the camera that were left out,
  // the others that are not missing, those of a sample, and how many matches of equal weight say as
  // much (Kish): that many the numbers below refer to.
  int num_matches = 0, num_copies = 0, num_fixed = 0, num_usable = 0, sample_size = 5,
      num_effective = 0;

  // The pose with a translation: inliers; log10 of the poses with so many that chance would make;
  // probability that a wrong match lies inside the gate; median parallax and standard deviation of
  // the residuals of the inliers.
  int support = 0;
  double log10_false_alarms = -kInfinity;
  double chance = 0.0;
  // Matches that fit the epipolar curves, but lie behind a camera, and those of them with which it
  // has only turned if an image is mirrored: of a mirrored image there are many.
  double behind = 0.0, mirrored_turn = 0.0;
  double parallax = kNaN, scale = kNaN;

  // The best rotation alone: matches that it explains, and its false alarms. Standard deviations by
  // which the inliers of the pose reject that the camera only turned. How many of them it leaves
  // displaced, and how far these alone reject it, be it that they lie on one side of the camera.
  int rotation_support = 0;
  double rotation_log10_false_alarms = kInfinity;
  double rotation_rejection = kInfinity;
  int num_displaced = 0;
  double displaced_rejection = 0.0;

  // Standard deviation of the rotation alone, where it is the answer, over all its components.
  double turn_sigma = 0.0;
  // Where that rotation agrees with one side only, and far more than chance with a pose beside it:
  // share of the sphere's cells with an inlier of the pose.
  double pose_coverage = 0.0;

  // Standard deviations of rotation and direction, over all their components.
  double rotation_sigma = 0.0, direction_sigma = 0.0;

  // What the matches say if every region is one witness, see testimony.h: log-likelihood ratio,
  // standard deviation of the direction, number of the regions that agree, and of all. Logarithm of
  // the prior of the pose over that of the most probable one.
  double log_ratio = kInfinity, regional_sigma = 0.0, num_regions = kInfinity,
         all_regions = kInfinity, log_prior = 0.0;
  bool has_prior = false;  // gravity is known
  // Angle by which the pose tilts the cameras against it, and its standard deviation.
  double tilt = 0.0, tilt_sigma = kNaN;

  // What the matches say of the rotation alone, where it is the answer: log-likelihood ratio, as
  // above.
  double rotation_log_ratio = kInfinity;

  // The likeliest pose that is truly different: its log-likelihood minus that of the pose, how
  // probable the regions make it, and the log-odds of the pose over it by the regions alone.
  // Matches that only the pose, and only that one, explains, if most of those that it explains are
  // its own. Share of the inliers on one plane, and whether it is so large that there is such a
  // pose by geometry.
  double rival_evidence = -kInfinity, rival_probability = 1.0, rival_regions = kNaN;
  double only_pose = 0.0, only_rival = 0.0;
  double plane_share = 0.0;
  bool has_twin = false;
  // Matches on one side of the camera that were left out, since they say another motion than all
  // others, whose answer this is.
  int num_contradicting = 0;
  // Whether the inliers crowd on a few regions, and one match of each region says something else.
  bool is_only_crowd = false;

  // Where the inliers of the answer are: how many are no copies; one minus the length of their mean
  // bearing and the same of all matches; shares of the sphere's cells with an inlier and with a
  // match.
  int num_distinct = std::numeric_limits<int>::max(), min_num_inliers = 0;
  double spread = 1.0, spread_of_matches = 1.0;
  double coverage = 1.0, match_coverage = 1.0;

  // Noise of the bearings, and the limit that the user knows (0: none).
  double noise = kNaN, max_noise = 0.0;
};

// What the matches may be, with the probability of each explanation; they sum to one.
struct Explanations {
  double nothing = 1.0;   // background alone: the views have nothing in common
  double rotation = 0.0;  // the camera only turned
  double surface = 0.0;   // one surface, seen from the pose that was found
  double motion = 0.0;    // a general scene, seen from that pose
  double rival = 0.0;     // another pose
};

// The explanations compared on the evidence so far.
Explanations explain(const Evidence& evidence);

// Status and warnings on the evidence so far.
Verdict judge(const Evidence& evidence);

// Matches without which nothing is estimated.
int fewest_matches(int sample_size);

// Whether a pose with translation was found that the evidence determines up to alternatives.
bool has_translation(Status status);

// Whether a pose that is refused is more probable than not: other pairs may confirm it.
bool is_worth_a_look(const Evidence& evidence);

// Whether so many of the matches agree with a rotation that it may be all that happened.
bool rotation_explains(const Evidence& evidence);

// Whether the inliers reject that the camera only turned, and yet do not know where it moved: then
// this pose is a poor one, and another may be better.
bool lacks_direction(const Evidence& evidence);

// Whether the inliers lie on less than half of what the matches lie on.
bool covers_little(const Evidence& evidence);

// Whether what turned is a small part of what the matches and the inliers of a pose lie on. A
// camera that turns sees all of it turn, while something that moves along turns by itself.
bool turned_in_part(const Evidence& evidence);

// Whether the parallax is so near the noise that a rotation alone must be tried.
bool has_hardly_any_parallax(const Evidence& evidence);

// Odds of the rival against the pose that was found, if only these two were possible; 0 if the
// rival is rejected.
double odds_of_rival(const Evidence& evidence);

// Probability that the pose is right, be it of a surface or of a general scene.
double probability_of_pose(const Evidence& evidence);

// Probability of a pose against background alone, from what the regions say of it and its prior.
double probability_by_regions(const Evidence& evidence);

// Log-odds of a pose over another one of the same matches by what the regions say of each.
double lead_by_regions(const Evidence& pose, const Evidence& rival);

// Whether inliers of which this share lies on one plane may have a twin pose.
bool is_planar(double share_on_plane);

}  // namespace epi360
