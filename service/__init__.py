"""The network side; imported first by the command, so this is where NumPy's threads are told to stay one.

Kernels run beside each other in one process; BLAS threads would spin against them and gain nothing at our sizes.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
