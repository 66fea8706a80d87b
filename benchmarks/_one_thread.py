# SPDX-License-Identifier: BSD-3-Clause
"""Imported before NumPy: holds the linear algebra of this process and its children to one thread.

One thread per method is what makes times comparable, and two workers fair on two cores.
"""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_variable] = "1"
