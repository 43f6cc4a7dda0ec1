"""Functions that GCC compiles for three generations of processors.

`cdef for_each_processor f(...) noexcept nogil` declares a function without a result. It is compiled, with all that it
calls, for processors with AVX-512, for those with AVX2 and for all others; which of the three runs is decided when the
module is loaded. What was built on one machine runs on every other. Other compilers, and those for other architectures,
compile it once.
"""

cdef extern from *:
    """
    #if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
    #define FOR_EACH_PROCESSOR \
        __attribute__((flatten, target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default"))) void
    #else
    #define FOR_EACH_PROCESSOR void
    #endif
    """
    ctypedef void for_each_processor "FOR_EACH_PROCESSOR"
