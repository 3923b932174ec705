"""The tests; importing this settles, before NumPy and OpenCV are loaded, that each process counts with one thread.

Several processes share the processors. On arrays as small as an image, the libraries' own threads mostly wait for each
other, which they do busily.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(_name, "1")
