/* Powers, inverse hyperbolic functions and the error function, once for both shapes as in elementary.h, after which they
 * come. */

/* ln x as the sum of two doubles, right to 2^-65, for x = 2^n (1 + f) normal and above 0; ln 2^shift is added */
INLINE F64 FN(log_double)(F64 x, F64 shift, F64 *low)
{
    F64 f, n = FN(log_reduce)(x, &f) + shift, d = 2.0 + f, sl;
    F64 s = FN(quotient)(f, FN(splat)(0.0), d, (2.0 - d) + f, &sl), z = s * s, zl = 2.0 * s * sl - FN(residual)(z, s, s);
    F64 w = s * z, wl = FN(ma)(s, zl, sl * z) - FN(residual)(w, s, z), z2 = z * z;
    F64 t = w * 0x1.5555555555555p-1, tl = FN(ma)(w, 0x1.5555555555555p-55, wl * 0x1.5555555555555p-1)
        - FN(residual)(t, w, FN(splat)(0x1.5555555555555p-1));
    F64 p = FN(ma)(z2, FN(ma)(z, 0x1.e02f956f9417ep-4, 0x1.df7ca82dd0ebep-4), FN(ma)(z, 0x1.1118c89b0b024p-3, 0x1.3b1395ce2e71ep-3));
    p = FN(ma)(z2, FN(ma)(z2, p, FN(ma)(z, 0x1.745d177aa105ep-3, 0x1.c71c71c6ea926p-3)),
        FN(ma)(z, 0x1.2492492492522p-2, 0x1.999999999999ap-2));
    F64 a = n * 0x1.62e42fefa38p-1, b = s + s, u = a + b, v = u + t; /* a is exact; 2 artanh s = ln(1 + f) */
    F64 rest = FN(ma)(n, 0x1.ef35793c76730p-45, (sl + sl) + tl) + w * z * p;
    rest = (((a - u) + b) + ((u - v) + t)) + rest;
    F64 h = v + rest;
    *low = (v - h) + rest;
    return h;
}

/* exp(h + l), for |h| <= 1000 and l below one unit in its last place or two, as a number times 2^k */
INLINE F64 FN(exp_double)(F64 h, F64 l, U64 *k)
{
    F64 r, e;
    *k = FN(exp_reduce)(h, &r, &e);
    l = l + e;
    F64 s = r + l;
    return FN(exp_small)(s, (r - s) + l);
}

/* x^y 2^(shift y) for x normal and above 0, y finite */
INLINE F64 FN(pow_near)(F64 x, F64 y, F64 shift)
{
    F64 l, h = FN(log_double)(x, shift, &l), p = y * h, q = FN(ma)(y, l, -FN(residual)(p, y, h));
    U64 k;
    q = FN(abs)(p) <= 800.0 ? q : FN(splat)(0.0);
    p = p > 800.0 ? 800.0 : p;
    F64 m = FN(exp_double)(p < -800.0 ? -800.0 : p, q, &k);
    return FN(scale)(m, k);
}

INLINE F64 FN(pow)(F64 x, F64 y)
{
    M64 near = (x >= DBL_MIN) & (x <= DBL_MAX) & (FN(abs)(y) <= DBL_MAX);
    F64 r = FN(pow_near)(near ? x : FN(splat)(1.0), near ? y : FN(splat)(1.0), FN(splat)(0.0));
    return FN(all)(near) ? r : FN(far_pow)(near, x, y, r);
}

/* two steps of Halley on a third of the exponent; then one from 26 bits, whose square is exact */
INLINE F64 FN(cbrt)(F64 x)
{
    F64 a = FN(abs)(x), b = a < DBL_MIN ? a * 0x1p54 : a, inverse = 1.0 / b;
    F64 high = FN(from_bits)((FN(bits)(b) >> 32) | UINT64_C(0x4330000000000000)) - 0x1p52;
    F64 t = FN(from_bits)(FN(bits)(FN(ma)(high, 0x1.5555555555555p-2, 0x1p52 + 715094163.0)) << 32), r = t * t * (t * inverse);
    t = t * (r + 2.0) / (r + r + 1.0);
    r = t * t * (t * inverse);
    t = FN(head)(t * (r + 2.0) / (r + r + 1.0));
    r = b / (t * t);
    t = FN(ma)(t, (r - t) / (t + t + r), t);
    t = a < DBL_MIN ? t * 0x1p-18 : t;
    return ((a > 0.0) & (a <= DBL_MAX)) ? FN(turn)(t, x) : x + x;
}

INLINE F64 FN(asinh)(F64 x)
{
    F64 a = FN(abs)(x);
    M64 big = a > 0x1p28;
    F64 b = big ? 1.0 : a, z = b * b, t = b + z / (1.0 + FN(sqrt)(1.0 + z));
    F64 y = FN(log1p)(big ? a - 1.0 : t);
    return FN(turn)(a < 0x1p-28 ? a : big ? y + 0x1.62e42fefa39efp-1 : y, x);
}

INLINE F64 FN(acosh)(F64 x)
{
    M64 big = x > 0x1p28;
    F64 t = (big ? 1.0 : x) - 1.0, y = FN(log1p)(big ? x - 1.0 : t + FN(sqrt)(FN(ma)(t, t, t + t)));
    return x < 1.0 ? FN(splat)(NAN) : big ? y + 0x1.62e42fefa39efp-1 : y;
}

INLINE F64 FN(atanh)(F64 x)
{
    F64 a = FN(abs)(x), y = 0.5 * FN(log1p)((a + a) / (1.0 - a));
    return FN(turn)(a < 0x1p-28 ? a : y, x);
}

/* erfc(a) = exp(-a^2) g / (1 + 2 a) for a >= 3/4, with g over (a - 4) / (a + 4) */
INLINE F64 FN(erfc_tail)(F64 a)
{
    F64 b = a > 28.0 ? 28.0 : a;
    b = b < 0.5 ? 0.5 : b;
    F64 t = (b - 4.0) / (b + 4.0), t2 = t * t, t4 = t2 * t2, h = b * b;
    F64 p0 = FN(ma)(t2, FN(ma)(t, 0x1.16ecefcfa5313p-4, 0x1.f7f5df66fd532p-7), FN(ma)(t, -0x1.1df1ad154a28ep-3, 0x1.3ba5916e9fd7fp+0));
    F64 p1 = FN(ma)(t2, FN(ma)(t, 0x1.3079edf649f8fp-5, -0x1.0fb06dfe6e8a2p-4),
        FN(ma)(t, 0x1.7fee004e13b37p-4, -0x1.9ddb23c3e7acdp-4));
    F64 p2 = FN(ma)(t2, FN(ma)(t, -0x1.a1df38dc01681p-13, -0x1.8d4aa2083ce7bp-11),
        FN(ma)(t, 0x1.49c6729b2b5dfp-8, -0x1.0962387d020acp-6));
    F64 p3 = FN(ma)(t2, FN(ma)(t, 0x1.7f0384639b587p-18, -0x1.78a56508d2e12p-17),
        FN(ma)(t, -0x1.9956576ddff19p-16, 0x1.3be0e04ac4323p-13));
    F64 p4 = FN(ma)(t2, FN(ma)(t, 0x1.c0151d8d75665p-24, 0x1.1eb66d2c8e3d8p-24),
        FN(ma)(t, -0x1.b8a8de198499bp-21, 0x1.41facfa33d424p-22));
    F64 p5 = FN(ma)(t, -0x1.58b4277890b87p-27, -0x1.a09ca665f27e9p-27);
    F64 g = FN(ma)(t4, FN(ma)(t4, FN(ma)(t4, FN(ma)(t4, FN(ma)(t4, p5, p4), p3), p2), p1), p0);
    U64 k;
    F64 m = FN(exp_double)(-h, FN(residual)(h, b, b), &k);
    return FN(scale)(m * g / (1.0 + 2.0 * b), k);
}

/* erf x for |x| <= 1 */
INLINE F64 FN(erf_near)(F64 x)
{
    F64 z = x * x, z2 = z * z, z4 = z2 * z2;
    F64 p0 = FN(ma)(z2, FN(ma)(z, -0x1.b82ce312849afp-6, 0x1.ce2f21a042b21p-4), FN(ma)(z, -0x1.812746b0379e6p-2, 0x1.06eba8214db69p-3));
    F64 p1 = FN(ma)(z2, FN(ma)(z, -0x1.f4d1df40274b3p-17, 0x1.f9a321a195b9dp-14),
        FN(ma)(z, -0x1.c02db3d8f264ep-11, 0x1.565bcd0db0530p-8));
    F64 p2 = FN(ma)(z2, FN(ma)(z, -0x1.386acc14bb471p-30, 0x1.f7a41b6768ef8p-27),
        FN(ma)(z, -0x1.5f1d38354a7c9p-23, 0x1.b9def1de3f8ebp-20));
    return FN(ma)(x, FN(ma)(z4, FN(ma)(z4, FN(ma)(z4, 0x1.0579a08899394p-34, p2), p1), p0), x);
}

INLINE F64 FN(erf)(F64 x)
{
    F64 a = FN(abs)(x), y = FN(erf_near)(a > 1.0 ? 1.0 : a);
    return FN(turn)(a > 1.0 ? 1.0 - FN(erfc_tail)(a) : y, x);
}

INLINE F64 FN(erfc)(F64 x)
{
    F64 a = FN(abs)(x), y = FN(erfc_tail)(a), near = 1.0 - FN(erf_near)(a > 0.75 ? 0.75 : x);
    return a > 0.75 ? (x < 0.0 ? 2.0 - y : y) : near;
}
