"""Keeps memory that was freed in the process, for estimators that allocate the same buffers for every image."""

import numpy as np

_LARGEST_BYTES = 31 * 2**20
"""Just below the largest block (32 MiB on 64 bits) from which glibc learns what is large."""


def keep_freed_memory() -> None:
    """Make the C library keep what is freed, up to twice 31 MiB, instead of handing it back at once.

    glibc takes blocks above a threshold from the system and gives them back when they are freed; every image then costs some
    3000 page faults, and a core that does something else meanwhile makes the slowest images slower still. The threshold rises
    to the largest such block freed so far, and so does what is kept at the top of the heap: one that is allocated and freed at
    once, untouched, is enough (`man 3 mallopt`, M_MMAP_THRESHOLD). Elsewhere this does nothing.
    """
    np.empty(_LARGEST_BYTES, np.uint8)
