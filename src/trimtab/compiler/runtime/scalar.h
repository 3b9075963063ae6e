/* Elementary functions of trimtab. Results have the same bits in scalar C and in vectors. You may use, change and pass
 * on this text, with or without this notice and under any licence; it comes without warranty. Compile it with
 * -ffp-contract=off, never with -ffast-math. */
#include <float.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#if defined(__FAST_MATH__)
#error "these functions need IEEE arithmetic: compile without -ffast-math"
#endif
#if defined(FLT_EVAL_METHOD) && (FLT_EVAL_METHOD == 2 || FLT_EVAL_METHOD == -1)
#error "these functions need double arithmetic without excess precision (x86: -mfpmath=sse -msse2)"
#endif
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#ifndef TT_FMA /* 1: `ma` rounds product and sum once, with the same bits on every machine; 0: twice, with other bits */
#define TT_FMA 1
#endif
#if defined(__arm__) && !(defined(__ARM_FP) && (__ARM_FP & 8))
#define TT_DOUBLE_FPU 0
#else
#define TT_DOUBLE_FPU 1
#endif
#if defined(__FP_FAST_FMA) || defined(__FMA__) || defined(__aarch64__) || (defined(__ARM_FEATURE_FMA) && TT_DOUBLE_FPU)
#define TT_FUSED fma
#else
#define TT_FUSED tt_fused
#endif
#ifndef TT_SINGLE /* 1: functions for float are those for double, rounded; 0: the C library's, without a double FPU */
#define TT_SINGLE TT_DOUBLE_FPU
#endif
#ifndef TT_INLINE
#if defined(__GNUC__)
#define TT_INLINE static inline __attribute__((unused))
#define TT_COLD static __attribute__((noinline, cold, unused))
#define TT_CALLED static __attribute__((noinline, unused))
#else
#define TT_INLINE static inline
#define TT_COLD static
#define TT_CALLED static
#endif
#endif
/* x as float. gcc's vectoriser of straight-line code (SLP; gcc 12, x86) leaves out the rounding of two neighbouring
 * numbers that are converted back to double. The empty instruction prevents that. TT_NO_SLP: this vectoriser is off. */
TT_INLINE float tt_single(double x)
{
    float y = (float)x;
#if defined(TT_NO_SLP) || !defined(__GNUC__) || defined(__clang__)
#elif defined(__SSE2__)
    __asm__("" : "+x"(y));
#elif defined(__aarch64__)
    __asm__("" : "+w"(y));
#endif
    return y;
}

TT_INLINE uint64_t tt_bits(double x)
{
    uint64_t u;
    memcpy(&u, &x, sizeof u);
    return u;
}

TT_INLINE double tt_from_bits(uint64_t u)
{
    double x;
    memcpy(&x, &u, sizeof x);
    return x;
}

TT_INLINE double tt_splat(double x)
{
    return x;
}

/* a b + c; TT_FUSED may be tt_fused() */
TT_INLINE double tt_ma(double a, double b, double c)
{
#if TT_FMA
    return TT_FUSED(a, b, c);
#else
    return a * b + c;
#endif
}

TT_INLINE int tt_within(double a, double limit)
{
    return tt_all(a <= limit);
}

TT_INLINE int tt_all(int m)
{
#if defined(__GNUC__)
    return (int)__builtin_expect(m, 1);
#else
    return m;
#endif
}

/* exchanges *u and *v if the highest bit is set, without branch or memory access, which the CPU would predict badly */
TT_INLINE void tt_swap(uint64_t bit, double *u, double *v)
{
    uint64_t apart = (tt_bits(*u) ^ tt_bits(*v)) & (0 - (bit >> 63));
    *u = tt_from_bits(tt_bits(*u) ^ apart);
    *v = tt_from_bits(tt_bits(*v) ^ apart);
}

TT_INLINE double tt_sqrt(double x)
{
    return sqrt(x);
}

TT_INLINE double tt_floor(double x)
{
    return floor(x);
}

TT_INLINE double tt_ceil(double x)
{
    return ceil(x);
}

TT_INLINE double tt_trunc(double x)
{
    return trunc(x);
}

TT_INLINE double tt_round_even(double x)
{
    return rint(x);
}

TT_INLINE double tt_round_away(double x)
{
    return round(x);
}
