"""HTTP and WebSocket service. Imported first by the command, so NumPy's number of threads is set here.

Kernels run beside each other in one process; BLAS threads would spin against them and gain nothing at our sizes.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
