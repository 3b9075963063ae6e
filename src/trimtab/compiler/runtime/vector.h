#ifndef TTV_INLINE
#define TTV_INLINE static inline __attribute__((always_inline, unused))
#endif
#if !TT_SINGLE
#error "lanes compute functions of float by those of double"
#endif
#define TTV_COLD static __attribute__((noinline, cold, unused))
#ifdef __clang__ /* without SLP, clang computes the loops over lanes one number after the other */
#if __has_builtin(__builtin_elementwise_fma) && (defined(__FMA__) || defined(__aarch64__))
#define TTV_FUSED(x, y, z) __builtin_elementwise_fma(x, y, z)
#elif defined(__AVX512F__) && TT_LANES == 8
#define TTV_FUSED(x, y, z) __builtin_ia32_vfmaddpd512_mask(x, y, z, -1, 4)
#elif defined(__FMA__) && TT_LANES == 4
#define TTV_FUSED(x, y, z) __builtin_ia32_vfmaddpd256(x, y, z)
#endif
#if __has_builtin(__builtin_elementwise_sqrt)
#define TTV_SQRT(x) __builtin_elementwise_sqrt(x)
#elif defined(__AVX512F__) && TT_LANES == 8
#define TTV_SQRT(x) __builtin_ia32_sqrtpd512(x, 4)
#elif defined(__AVX__) && TT_LANES == 4
#define TTV_SQRT(x) __builtin_ia32_sqrtpd256(x)
#endif
#elif defined(__AVX512F__) && TT_LANES == 8 /* same code as the loop over lanes, but much faster to compile */
#define TTV_FUSED(x, y, z) __builtin_ia32_vfmaddpd512_mask(x, y, z, -1, 4)
#define TTV_SQRT(x) __builtin_ia32_sqrtpd512_mask(x, (vf64){}, -1, 4)
#elif defined(__AVX__) && TT_LANES == 4
#ifdef __FMA__
#define TTV_FUSED(x, y, z) __builtin_ia32_vfmaddpd256(x, y, z)
#endif
#define TTV_SQRT(x) __builtin_ia32_sqrtpd256(x)
#endif
typedef double vf64 __attribute__((vector_size(8 * TT_LANES)));
typedef int64_t vi64 __attribute__((vector_size(8 * TT_LANES)));
typedef uint64_t vu64 __attribute__((vector_size(8 * TT_LANES)));

TTV_INLINE vf64 ttv_splat(double x)
{
    return x - (vf64){}; /* not 0 + x, which loses the sign of -0 */
}
TTV_INLINE vf64 ttv_splat(vf64 x)
{
    return x;
}

TTV_INLINE vu64 ttv_bits(vf64 x)
{
    return (vu64)x;
}

TTV_INLINE vf64 ttv_from_bits(vu64 u)
{
    return (vf64)u;
}

TTV_INLINE int ttv_all(vi64 m)
{
#if defined(__AVX512DQ__) && TT_LANES == 8
    typedef long long tt_mask512 __attribute__((vector_size(64)));
    return __builtin_expect((unsigned char)__builtin_ia32_cvtq2mask512((tt_mask512)m) == 255, 1);
#elif defined(__AVX__) && TT_LANES == 4
    return __builtin_expect(__builtin_ia32_movmskpd256((vf64)m) == 15, 1);
#else
    int64_t all = m[0];
    for (int i = 1; i < TT_LANES; i++) all &= m[i];
    return __builtin_expect(all != 0, 1);
#endif
}

/* true if a <= limit in all lanes */
TTV_INLINE int ttv_within(vf64 a, double limit)
{
#if defined(__AVX512DQ__) && TT_LANES == 8
    return __builtin_expect((unsigned char)__builtin_ia32_cmppd512_mask(a, ttv_splat(limit), 18, -1, 4) == 255, 1);
#else
    return ttv_all(a <= limit);
#endif
}

/* a b + c, each a vector or a number */
template <class A, class B, class C> TTV_INLINE vf64 ttv_ma(A a, B b, C c)
{
    vf64 x = ttv_splat(a), y = ttv_splat(b), z = ttv_splat(c), r;
#if TT_FMA && defined(TTV_FUSED)
    r = TTV_FUSED(x, y, z);
#elif TT_FMA
    for (int i = 0; i < TT_LANES; i++) r[i] = TT_FUSED(x[i], y[i], z[i]);
#else
    r = x * y + z;
#endif
    return r;
}

TTV_INLINE int ttv_any(vi64 m)
{
    return !ttv_all(m == 0);
}

/* exchanges *u and *v in the lanes where the highest bit is set */
TTV_INLINE void ttv_swap(vu64 bit, vf64 *u, vf64 *v)
{
    vi64 turned = (vi64)bit < 0;
    vf64 w = turned ? *v : *u;
    *v = turned ? *u : *v;
    *u = w;
}

TTV_INLINE vf64 ttv_sqrt(vf64 x)
{
    vf64 r = {};
#ifdef TTV_SQRT
    r = TTV_SQRT(x);
#else
    for (int i = 0; i < TT_LANES; i++) r[i] = __builtin_sqrt(x[i]);
#endif
    return r;
}

TTV_INLINE vf64 ttv_round_even(vf64 x)
{
    vf64 a = ttv_abs(x), r = (a + 0x1p52) - 0x1p52;
    return ttv_copysign(a < 0x1p52 ? r : a, x);
}

TTV_INLINE vf64 ttv_floor(vf64 x)
{
    vf64 r = ttv_round_even(x);
    return r > x ? r - 1.0 : r;
}

TTV_INLINE vf64 ttv_ceil(vf64 x)
{
    vf64 r = ttv_round_even(x);
    return ttv_copysign(r < x ? r + 1.0 : r, x);
}

TTV_INLINE vf64 ttv_trunc(vf64 x)
{
    vf64 a = ttv_abs(x), r = ttv_round_even(a);
    return ttv_copysign(r > a ? r - 1.0 : r, x);
}

TTV_INLINE vf64 ttv_round_away(vf64 x)
{
    vf64 a = ttv_abs(x), r = ttv_round_even(a), d = r - a;
    return ttv_copysign(d == -0.5 ? r + 1.0 : r, x);
}
