"""Memory that the command line keeps between calls instead of giving it back to the system and taking it again."""

import ctypes

_TRIM_THRESHOLD, _MMAP_MAX = -1, -4  # numbers of glibc's mallopt


def keep() -> None:
    """Let glibc serve large blocks from a heap that never shrinks; nothing where there is another C library.

    Otherwise every call of a compiled program maps its results and temporaries again, and touching fresh pages takes a
    quarter of the time of a batch of mesh forces. The most that a process holds at once stays what it was.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # not glibc; Windows
        return
    mallopt(_MMAP_MAX, 0)
    mallopt(_TRIM_THRESHOLD, 2**31 - 1)
