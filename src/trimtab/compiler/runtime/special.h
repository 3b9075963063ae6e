/* Powers, inverse hyperbolic functions and the error function, written once for scalars and vectors. This text follows
 * that of elementary.h. */

/* ln x + ln 2^shift as the sum of two doubles, accurate to 2^-65, for a positive normal number x = 2^n (1 + f) */
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

/* exp(h + l) as the sum of two doubles times 2^k, for |h| <= 1000 and l of a few units in the last place of h */
INLINE F64 FN(exp_double)(F64 h, F64 l, F64 *low, U64 *k)
{
    F64 r, e;
    *k = FN(exp_reduce)(h, &r, &e);
    l = l + e;
    F64 s = r + l, t = 1.0 + s, c = ((1.0 - t) + s) + FN(ma)(0.5 * s, s, FN(exp_rest)(s, (r - s) + l)), y = t + c;
    *low = (t - y) + c;
    return y;
}

/* x^y 2^(shift y), for a positive normal number x and a finite y */
INLINE F64 FN(pow_near)(F64 x, F64 y, F64 shift)
{
    F64 l, h = FN(log_double)(x, shift, &l), p = y * h, q = FN(ma)(y, l, -FN(residual)(p, y, h));
    F64 low;
    U64 k;
    q = FN(abs)(p) <= 800.0 ? q : FN(splat)(0.0);
    p = p > 800.0 ? 800.0 : p;
    F64 m = FN(exp_double)(p < -800.0 ? -800.0 : p, q, &low, &k);
    return FN(scale)(m, k);
}

INLINE F64 FN(pow)(F64 x, F64 y)
{
    M64 near = (x >= DBL_MIN) & (x <= DBL_MAX) & (FN(abs)(y) <= DBL_MAX);
    F64 r = FN(pow_near)(near ? x : FN(splat)(1.0), near ? y : FN(splat)(1.0), FN(splat)(0.0));
    return FN(all)(near) ? r : FN(far_pow)(near, x, y, r);
}

/* two Halley steps from a third of the exponent; then one step from 26 bits, whose square is exact */
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

/* erfc(a) = exp(-a^2) g / (1 + 2 a) for a >= 3/4, with g a polynomial in (a - 4) / (a + 4) */
INLINE F64 FN(erfc_tail)(F64 a)
{
    F64 b = a > 28.0 ? 28.0 : a;
    b = b < 0.5 ? 0.5 : b;
    F64 t = (b - 4.0) / (b + 4.0), t2 = t * t, t4 = t2 * t2, h = b * b, lack, low;
    F64 p0 = FN(ma)(t2, FN(ma)(t, 0x1.16ecefcfa5218p-4, 0x1.f7f5df66fd764p-7), t * -0x1.1df1ad154a28dp-3);
    F64 p1 = FN(ma)(t2, FN(ma)(t, 0x1.3079edf5ca414p-5, -0x1.0fb06dfe4ff07p-4),
        FN(ma)(t, 0x1.7fee004e16a7cp-4, -0x1.9ddb23c3e8d74p-4));
    F64 p2 = FN(ma)(t2, FN(ma)(t, -0x1.a1df619d30976p-13, -0x1.8d4a9bfa67a62p-11),
        FN(ma)(t, 0x1.49c672c9eb09fp-8, -0x1.096238835cd8fp-6));
    F64 p3 = FN(ma)(t2, FN(ma)(t, 0x1.7ec70dc27818dp-18, -0x1.789141fd04ff0p-17),
        FN(ma)(t, -0x1.9950cf16a1535p-16, 0x1.3be070039b096p-13));
    F64 p4 = FN(ma)(t2, FN(ma)(t, 0x1.a87bd2f1460f5p-24, 0x1.2f826ab97fd73p-24),
        FN(ma)(t, -0x1.b58082196913ep-21, 0x1.3d9cc7db728e7p-22));
    F64 p5 = FN(ma)(t, -0x1.0d25bb4a084d8p-27, -0x1.d797cbe8edee2p-27);
    F64 p = FN(ma)(t4, FN(ma)(t4, FN(ma)(t4, FN(ma)(t4, FN(ma)(t4, p5, p4), p3), p2), p1), p0);
    F64 g = 0x1.3ba5916e9fd7fp+0 + p, gl = ((0x1.3ba5916e9fd7fp+0 - g) + p) - 0x1.a79fe122ee30ap-55, d = 1.0 + (b + b);
    U64 k;
    F64 m = FN(exp_double)(-h, FN(residual)(h, b, b), &low, &k);
    F64 q = FN(quotient)(g, gl, d, (1.0 - d) + (b + b), &lack), y = m * q;
    return FN(scale)(y + (FN(ma)(m, lack, low * q) - FN(residual)(y, m, q)), k);
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
