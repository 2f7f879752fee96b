/* Tells whether the processor and the system can run the instructions that a library's kernels were compiled for.

Source: Intel 64 and IA-32 Architectures Software Developer's Manual, volume 2A, CPUID (leaves 1 and 7), and volume 1,
sections 14.3 and 15.2: the system must also save the registers, which XGETBV tells. LEVEL is that of the x86-64 psABI,
section 3.1.1; 0 is any processor. */

#if LEVEL >= 2
#include <cpuid.h>

static int has(unsigned found, unsigned wanted) { return (found & wanted) == wanted; }
#endif

#if LEVEL >= 3
static unsigned read_xcr0(void) {
    unsigned low, high;
    __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    return low;
}
#endif

#define BIT(number) (1u << (number))

#if defined(_WIN32)
/* Halide's objects ask Microsoft's C library for this name where they use floating point; other C libraries lack it. */
int _fltused = 0;
__declspec(dllexport)
#else
__attribute__((visibility("default")))
#endif
int lobewise_runs_here(void) {
#if LEVEL >= 2
    unsigned a, b, c, d;
    /* SSE3, SSSE3, SSE4.1, SSE4.2 */
    if (!__get_cpuid(1, &a, &b, &c, &d) || !has(c, BIT(0) | BIT(9) | BIT(19) | BIT(20))) return 0;
#endif
#if LEVEL >= 3
    /* FMA, OSXSAVE, AVX, F16C; the registers of SSE and AVX */
    if (!has(c, BIT(12) | BIT(27) | BIT(28) | BIT(29)) || !has(read_xcr0(), BIT(1) | BIT(2))) return 0;
    /* BMI1, AVX2, BMI2 */
    if (!__get_cpuid_count(7, 0, &a, &b, &c, &d) || !has(b, BIT(3) | BIT(5) | BIT(8))) return 0;
#endif
#if LEVEL >= 4
    /* AVX-512 F, DQ, CD, BW, VL; the registers of AVX-512 */
    if (!has(b, BIT(16) | BIT(17) | BIT(28) | BIT(30) | BIT(31))) return 0;
    if (!has(read_xcr0(), BIT(5) | BIT(6) | BIT(7))) return 0;
#endif
    return 1;
}
