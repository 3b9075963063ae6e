/* Elementary functions, written once for scalars and vectors. elementary.py replaces F64 (number), U64 (its bits), M64
 * (truth value), INLINE, COLD (seldom called) and FN(name), and puts scalar.h or vector.h before this text. A blank
 * line separates two functions, and must not be anywhere else. ma(a, b, c) is a b + c. Coefficients are minimax,
 * computed as docs/compiler/generator.md describes. */

INLINE F64 FN(abs)(F64 x)
{
    return FN(from_bits)(FN(bits)(x) & UINT64_C(0x7fffffffffffffff));
}

INLINE F64 FN(copysign)(F64 x, F64 sign)
{
    return FN(from_bits)((FN(bits)(x) & UINT64_C(0x7fffffffffffffff)) | (FN(bits)(sign) & UINT64_C(0x8000000000000000)));
}

/* y, with its sign changed if x is negative */
INLINE F64 FN(turn)(F64 y, F64 x)
{
    return FN(from_bits)(FN(bits)(y) ^ (FN(bits)(x) & UINT64_C(0x8000000000000000)));
}

/* the leading 26 bits of x: a product of two such numbers is exact */
INLINE F64 FN(head)(F64 x)
{
    return FN(from_bits)(FN(bits)(x) & UINT64_C(0xfffffffff8000000));
}

INLINE M64 FN(is_finite)(F64 x)
{
    return FN(abs)(x) <= DBL_MAX;
}

INLINE F64 FN(rsqrt)(F64 x)
{
    return 1.0 / FN(sqrt)(x);
}

/* n - q d, for a product q d near n */
INLINE F64 FN(residual)(F64 n, F64 q, F64 d)
{
#if TT_FMA
    return FN(ma)(-q, d, n);
#else
    F64 qh = FN(head)(q), dh = FN(head)(d);
    return ((n - qh * dh) - qh * (d - dh)) - (q - qh) * d;
#endif
}

/* (n + nl) / (d + dl) as a sum of two doubles: the quotient and its error *lack */
INLINE F64 FN(quotient)(F64 n, F64 nl, F64 d, F64 dl, F64 *lack)
{
    F64 inverse = 1.0 / d, q = n * inverse;
    *lack = (FN(residual)(n, q, d) + FN(ma)(-q, dl, nl)) * inverse;
    return q;
}

/* Cody-Waite. sin r = *s + *sl, cos r = *c + *cl for a = q pi/2 + r, |r| <= pi/4, 0 <= a <= 1e6. Returns q in the low
 * bits. */
INLINE U64 FN(quarter_turn)(F64 a, F64 *s, F64 *sl, F64 *c, F64 *cl)
{
    F64 t = FN(ma)(a, 0x1.45f306dc9c883p-1, 0x1.8p52), n = t - 0x1.8p52;
    F64 x = FN(ma)(n, -0x1.921fb544p+0, a), y = FN(ma)(n, -0x1.0b4611a8p-34, x); /* products with n are exact */
    F64 e = FN(ma)(n, -0x1.d9cceba4p-66, -FN(ma)(n, -0x1.0b4611a8p-34, x - y));
    F64 r = y - e, l = FN(ma)(n, -0x1.b839a252p-104, (y - r) - e); /* r + l = y - e, also if y and e cancel */
    F64 z = y * y, z2 = z * z, yz = y * z, o = FN(ma)(z, -0.5, 1.0);
    F64 p0 = FN(ma)(z, 0x1.111111110f730p-7, -0x1.5555555555548p-3);
    F64 p = FN(ma)(z2, FN(ma)(z2, FN(ma)(z, 0x1.5d8b55f8305f4p-33, -0x1.ae5e4b854b2dap-26),
        FN(ma)(z, 0x1.71de35552cccap-19, -0x1.a01a019be9226p-13)), p0);
    F64 q = FN(ma)(z2, FN(ma)(z2, FN(ma)(z, -0x1.8fa684ce01fcdp-37, 0x1.1ee9dbcf3e81cp-29),
        FN(ma)(z, -0x1.27e4f7f1915e0p-22, 0x1.a01a019c8f253p-16)),
        FN(ma)(z, -0x1.6c16c16c15015p-10, 0x1.555555555554bp-5));
    *s = r; /* sin(y - e) = (y - e) + (sin y - y) + e (1 - cos y) */
    *sl = FN(ma)(yz, p, FN(ma)(e * z, FN(ma)(z, -0x1.5555555555555p-5, 0.5), l));
    *c = o; /* cos(y - e) = cos y + e sin y */
    *cl = FN(ma)(z2, q, FN(ma)(e, FN(ma)(yz, p0, y), FN(ma)(z, -0.5, 1.0 - o)));
    return FN(bits)(t);
}

INLINE void FN(sincos)(F64 x, F64 *sine, F64 *cosine)
{
    F64 a = FN(abs)(x), s, sl, c, cl;
    U64 q = FN(quarter_turn)(a, &s, &sl, &c, &cl), turn = q << 62, odd = q << 63;
    F64 u = s + sl, v = c + cl;
    FN(swap)(odd, &u, &v);
    u = FN(from_bits)(FN(bits)(u) ^ ((FN(bits)(x) ^ turn) & UINT64_C(0x8000000000000000)));
    v = FN(from_bits)(FN(bits)(v) ^ ((odd ^ turn) & UINT64_C(0x8000000000000000)));
    if (!FN(within)(a, 1e6)) {
        u = FN(far_sin)(a <= 1e6, x, u);
        v = FN(far_cos)(a <= 1e6, x, v);
    }
    *sine = u;
    *cosine = v;
}

INLINE F64 FN(sin)(F64 x)
{
    F64 s, c;
    FN(sincos)(x, &s, &c);
    return s;
}

INLINE F64 FN(cos)(F64 x)
{
    F64 s, c;
    FN(sincos)(x, &s, &c);
    return c;
}

INLINE F64 FN(tan)(F64 x)
{
    F64 a = FN(abs)(x), s, sl, c, cl, lack;
    U64 q = FN(quarter_turn)(a, &s, &sl, &c, &cl);
    M64 odd = (q & 1) != 0;
    F64 u = s + sl, ul = (s - u) + sl, v = c + cl, vl = (c - v) + cl;
    F64 t = FN(quotient)(odd ? -v : u, odd ? -vl : ul, odd ? u : v, odd ? ul : vl, &lack);
    t = FN(turn)(t + lack, x);
    return FN(within)(a, 1e6) ? t : FN(far_tan)(a <= 1e6, x, t);
}

/* atan(n / d) for 0 <= n <= d as k pi/4 + t + rest, with k = 0, 1 and |t| <= tan(pi/8) */
INLINE F64 FN(angle)(F64 n, F64 d, F64 *k, F64 *rest)
{
    M64 mid = n > d * 0x1.a827999fcef32p-2;
    F64 m = n - d, p = n + d, lack;
    F64 t = FN(quotient)(mid ? m : n, mid ? n - (m + d) : FN(splat)(0.0), mid ? p : d, mid ? (d - p) + n : FN(splat)(0.0), &lack);
    F64 z = t * t, z2 = z * z, z4 = z2 * z2;
    F64 c0 = FN(ma)(z2, FN(ma)(z, 0x1.c71c70e603ac2p-4, -0x1.24924922ad473p-3),
        FN(ma)(z, 0x1.9999999995868p-3, -0x1.555555555553dp-2));
    F64 c1 = FN(ma)(z2, FN(ma)(z, 0x1.df0f40715ec66p-5, -0x1.10ebb75fb50fap-4),
        FN(ma)(z, 0x1.3b11190515b37p-4, -0x1.745cf8db09af3p-4));
    F64 c2 = FN(ma)(z2, -0x1.256a0daccd45cp-6, FN(ma)(z, 0x1.37d564b8ffc85p-5, -0x1.9cd2980469d0cp-5));
    *k = mid ? FN(splat)(1.0) : FN(splat)(0.0);
    *rest = FN(ma)(t * z, FN(ma)(z4, FN(ma)(z4, c2, c1), c0), FN(ma)(-lack, z, lack));
    return t;
}

/* k pi/4 + t + rest, rounded once */
INLINE F64 FN(angle_sum)(F64 k, F64 t, F64 rest)
{
    F64 base = k * 0x1.921fb54442d18p-1, s = base + t;
    return s + (((base - s) + t) + FN(ma)(k, 0x1.1a62633145c07p-55, rest));
}

INLINE F64 FN(atan)(F64 x)
{
    F64 a = FN(abs)(x), b = a > 0x1p60 ? 0x1p60 : a, k, rest;
    M64 steep = b > 1.0;
    F64 t = FN(angle)(steep ? 1.0 : b, steep ? b : 1.0, &k, &rest);
    return FN(turn)(FN(angle_sum)(steep ? 2.0 - k : k, steep ? -t : t, steep ? -rest : rest), x);
}

/* atan2 of y and x, if their magnitudes are not extreme */
INLINE F64 FN(atan2_near)(F64 y, F64 x)
{
    F64 a = FN(abs)(x), b = FN(abs)(y), k, rest;
    M64 steep = b > a, back = FN(turn)(FN(splat)(1.0), x) < 0.0, less = steep ^ back;
    F64 t = FN(angle)(steep ? a : b, steep ? b : a, &k, &rest);
    k = steep ? 2.0 - k : k;
    k = back ? 4.0 - k : k;
    return FN(turn)(FN(angle_sum)(k, less ? -t : t, less ? -rest : rest), y);
}

INLINE F64 FN(atan2)(F64 y, F64 x)
{
    F64 a = FN(abs)(x), b = FN(abs)(y), n = b > a ? a : b, d = b > a ? b : a, r = FN(atan2_near)(y, x);
    M64 near = (d >= 0x1p-400) & (d <= 0x1p400) & ((n >= 0x1p-900) | (n == 0.0));
    return FN(all)(near) ? r : FN(far_atan2)(near, y, x, r);
}

/* arcsin of s, as the sum of s and a rest: s is a = |x|, or sqrt((1 - a) / 2) if a > 1/2 */
INLINE F64 FN(arc)(F64 a, M64 big, F64 *rest)
{
    F64 z = big ? (1.0 - a) * 0.5 : a * a, root = FN(sqrt)(z), s = big ? root : a;
    F64 lack = FN(residual)(z, root, root) / (root + root + DBL_MIN), z2 = z * z, z4 = z2 * z2;
    F64 p0 = FN(ma)(z2, FN(ma)(z, 0x1.f1c71a94f2d36p-6, 0x1.6db6db7212683p-5),
        FN(ma)(z, 0x1.333333332e131p-4, 0x1.5555555555577p-3));
    F64 p1 = FN(ma)(z2, FN(ma)(z, 0x1.758589f2156b5p-7, 0x1.ca1f8d6bcf0d1p-7),
        FN(ma)(z, 0x1.1c49f05ce52dcp-6, 0x1.6e8bdee0414d9p-6));
    F64 p2 = FN(ma)(z2, FN(ma)(z, -0x1.57fd4946aaea3p-6, 0x1.639c56e3597b0p-6),
        FN(ma)(z, 0x1.e5f5c7eec4f59p-9, 0x1.613c89b03bc3bp-7));
    p2 = FN(ma)(z4, 0x1.0b46a9b2a951ap-5, p2);
    *rest = FN(ma)(s * z, FN(ma)(z4, FN(ma)(z4, p2, p1), p0), big ? lack : FN(splat)(0.0));
    return s;
}

INLINE F64 FN(asin)(F64 x)
{
    F64 a = FN(abs)(x), rest;
    M64 big = a > 0.5;
    F64 s = FN(arc)(a, big, &rest);
    F64 base = big ? 0x1.921fb54442d18p+0 : FN(splat)(0.0), low = big ? 0x1.1a62633145c07p-54 : FN(splat)(0.0);
    F64 u = big ? -2.0 * s : s, v = big ? -2.0 * rest : rest, w = base + u;
    return FN(turn)(w + (((base - w) + u) + (low + v)), x);
}

INLINE F64 FN(acos)(F64 x)
{
    F64 a = FN(abs)(x), rest;
    M64 big = a > 0.5, back = x < -0.5;
    F64 s = FN(arc)(a, big, &rest), k = big ? 2.0 : FN(splat)(1.0);
    F64 base = big ? (back ? 0x1.921fb54442d18p+1 : FN(splat)(0.0)) : 0x1.921fb54442d18p+0;
    F64 low = big ? (back ? 0x1.1a62633145c07p-53 : FN(splat)(0.0)) : 0x1.1a62633145c07p-54;
    M64 positive = x >= 0.0, less = big ? back : positive;
    F64 u = less ? -k * s : k * s, v = less ? -k * rest : k * rest, w = base + u;
    return w + (((base - w) + u) + (low + v));
}

/* c in exp(r + e) = 1 + r + r^2 / 2 + c, for |r| <= ln(2)/2 and tiny e */
INLINE F64 FN(exp_rest)(F64 r, F64 e)
{
    F64 z = r * r, z2 = z * z;
    F64 even = FN(ma)(z2, FN(ma)(z2, 0x1.1f83edded3c89p-29, FN(ma)(z, 0x1.27e4d13d2c196p-22, 0x1.a01a01ab16668p-16)),
        FN(ma)(z, 0x1.6c16c16c15778p-10, 0x1.5555555555557p-5));
    F64 odd = FN(ma)(z2, FN(ma)(z2, 0x1.af5ff65958db8p-26, FN(ma)(z, 0x1.71ddf7af0420bp-19, 0x1.a01a01b0206d5p-13)),
        FN(ma)(z, 0x1.111111110f62ap-7, 0x1.5555555555559p-3));
    return FN(ma)(z, FN(ma)(z, even, r * odd), e);
}

/* x = k ln 2 + r + e; returns k in two's complement */
INLINE U64 FN(exp_reduce)(F64 x, F64 *r, F64 *e)
{
    F64 t = FN(ma)(x, 0x1.71547652b82fep+0, 0x1.8p52), n = t - 0x1.8p52;
    F64 h = FN(ma)(n, -0x1.62e42fefa38p-1, x); /* exact */
    *r = FN(ma)(n, -0x1.ef35793c76730p-45, h);
    *e = FN(ma)(n, -0x1.ef35793c76730p-45, h - *r);
    return FN(bits)(t) - UINT64_C(0x4338000000000000);
}

/* exp(r + e) */
INLINE F64 FN(exp_small)(F64 r, F64 e)
{
    F64 s = 1.0 + r;
    return s + (((1.0 - s) + r) + FN(ma)(0.5 * r, r, FN(exp_rest)(r, e)));
}

/* y 2^k, in two steps, so that a subnormal result is rounded only once, and overflow gives infinity */
INLINE F64 FN(scale)(F64 y, U64 k)
{
    U64 both = k + 2048, half = both >> 1;
    return y * FN(from_bits)((half - 1) << 52) * FN(from_bits)((both - half - 1) << 52);
}

/* exp of any number */
COLD F64 FN(exp_any)(F64 x)
{
    F64 a = x > 710.0 ? 710.0 : x, r, e;
    a = a < -746.0 ? -746.0 : a;
    U64 k = FN(exp_reduce)(a, &r, &e);
    return FN(scale)(FN(exp_small)(r, e), k);
}

INLINE F64 FN(exp)(F64 x)
{
    F64 r, e;
    if (!FN(within)(FN(abs)(x), 708.0)) return FN(exp_any)(x);
    U64 k = FN(exp_reduce)(x, &r, &e);
    return FN(from_bits)(FN(bits)(FN(exp_small)(r, e)) + (k << 52));
}

INLINE F64 FN(exp2)(F64 x)
{
    F64 a = x > 1025.0 ? 1025.0 : x;
    a = a < -1080.0 ? -1080.0 : a;
    F64 t = a + 0x1.8p52, f = a - (t - 0x1.8p52), h = FN(head)(f);
    F64 p = h * 0x1.62e43p-1, l = FN(ma)(f - h, 0x1.62e43p-1, f * -0x1.05c610ca86c39p-29), r = p + l;
    return FN(scale)(FN(exp_small)(r, (p - r) + l), FN(bits)(t) - UINT64_C(0x4338000000000000));
}

/* (exp(x) - 1) / 4 as the sum of two doubles, for x <= 710.7 */
INLINE F64 FN(expm1_quarter)(F64 x, F64 *low)
{
    F64 a = x > 710.7 ? 710.7 : x, r, e;
    a = a < -40.0 ? -40.0 : a;
    U64 k = FN(exp_reduce)(a, &r, &e);
    F64 y = FN(from_bits)((k + 1021) << 52), g = y - 0.25, gy = g - y, b = y * r, s = g + b;
    F64 q = 0.5 * r * r, c = FN(exp_rest)(r, e) - FN(residual)(q, 0.5 * r, r), d = y * q, t = s + d;
    F64 m = ((g - s) + b) + ((s - t) + d) + FN(ma)(y, c, (y - (g - gy)) - (0.25 + gy)), h = t + m;
    *low = (t - h) + m;
    return h;
}

INLINE F64 FN(expm1)(F64 x)
{
    F64 l, h = FN(expm1_quarter)(x, &l);
    return FN(abs)(x) < 0x1p-54 ? x : 4.0 * h;
}

INLINE F64 FN(sinh)(F64 x)
{
    F64 a = FN(abs)(x), pl, ql, p = FN(expm1_quarter)(a, &pl), q = FN(expm1_quarter)(-a, &ql);
    F64 s = p - q, y = s + (((p - s) - q) + (pl - ql));
    return a < 0x1p-28 ? x : FN(turn)(y + y, x);
}

INLINE F64 FN(cosh)(F64 x)
{
    F64 a = FN(abs)(x), pl, ql, p = FN(expm1_quarter)(a, &pl), q = FN(expm1_quarter)(-a, &ql);
    F64 s = p + q, m = ((p - s) + q) + (pl + ql), w = s + 0.5, b = w - s;
    return 2.0 * (w + (((s - (w - b)) + (0.5 - b)) + m));
}

INLINE F64 FN(tanh)(F64 x)
{
    F64 a = FN(abs)(x), l, h = FN(expm1_quarter)(-2.0 * a, &l), lack;
    F64 n = -2.0 * h, d = 1.0 - n, t = FN(quotient)(n, -2.0 * l, d, ((1.0 - d) - n) + 2.0 * l, &lack);
    return a < 0x1p-28 ? x : FN(turn)(t + lack, x);
}

INLINE F64 FN(logistic)(F64 x)
{
    F64 a = FN(abs)(x), r, e, lack;
    a = a > 746.0 ? 746.0 : a;
    U64 k = FN(exp_reduce)(-a, &r, &e);
    F64 s = 1.0 + r, m = ((1.0 - s) + r) + FN(ma)(0.5 * r, r, FN(exp_rest)(r, e)), p = s + m, l = (s - p) + m;
    F64 h = FN(scale)(p, k), d = 1.0 + h;
    M64 low = x < 0.0;
    F64 q = FN(quotient)(low ? p : FN(splat)(1.0), low ? l : FN(splat)(0.0), d, ((1.0 - d) + h) + FN(scale)(l, k), &lack);
    q = q + lack;
    return low ? FN(scale)(q, k) : q;
}

/* n ln 2 + ln(1 + f) + c, for 1 + f in [sqrt(1/2), sqrt 2] and tiny c */
INLINE F64 FN(log_sum)(F64 n, F64 f, F64 c)
{
    F64 h = 0.5 * f * f, s = f / (2.0 + f), z = s * s, z2 = z * z;
    F64 p = FN(ma)(z2, FN(ma)(z2, FN(ma)(z2, 0x1.2f02685fbf401p-3, FN(ma)(z, 0x1.39a209ad25b47p-3, 0x1.74663bb382e34p-3)),
        FN(ma)(z, 0x1.c71c5219dbd25p-3, 0x1.24924941db7dfp-2)), FN(ma)(z, 0x1.999999997ff61p-2, 0x1.5555555555592p-1));
    F64 v = FN(ma)(n, 0x1.62e42fefa38p-1, f), b = FN(ma)(n, 0x1.62e42fefa38p-1, -v) + f; /* products exact */
    return v + (b + (FN(ma)(s, FN(ma)(z, p, h), -h) + FN(ma)(n, 0x1.ef35793c76730p-45, c)));
}

/* x = 2^n (1 + f); if |n| > 1021, x may not be a positive normal number */
INLINE F64 FN(log_reduce)(F64 x, F64 *f)
{
    U64 u = FN(bits)(x) + (UINT64_C(0x3ff0000000000000) - UINT64_C(0x3fe6a09e00000000));
    *f = FN(from_bits)((u & UINT64_C(0x000fffffffffffff)) + UINT64_C(0x3fe6a09e00000000)) - 1.0;
    return FN(from_bits)((u >> 52) | UINT64_C(0x4330000000000000)) - (0x1p52 + 1023.0);
}

INLINE F64 FN(log)(F64 x)
{
    F64 f, n = FN(log_reduce)(x, &f), y = FN(log_sum)(n, f, FN(splat)(0.0)), size = FN(abs)(n);
    return FN(within)(size, 1021.0) ? y : FN(far_log)(size <= 1021.0, x, y);
}

INLINE F64 FN(log1p)(F64 x)
{
    F64 u = 1.0 + x, b = u - 1.0, c = (1.0 - (u - b)) + (x - b), f, n = FN(log_reduce)(u, &f);
    F64 size = FN(abs)(n);
    M64 plain = n == 0.0;
    F64 y = FN(log_sum)(n, plain ? x : f, plain ? FN(splat)(0.0) : c / u);
    y = x == 0.0 ? x : y;
    return FN(within)(size, 1021.0) ? y : FN(far_log1p)(size <= 1021.0, x, y);
}
