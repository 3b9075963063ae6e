/* Slow paths for arguments outside the range of elementary.h, one number at a time. near: y is already the result. */

/* high and low 64 bits of a b */
TT_INLINE uint64_t tt_product(uint64_t a, uint64_t b, uint64_t *low)
{
    uint64_t al = (uint32_t)a, ah = a >> 32, bl = (uint32_t)b, bh = b >> 32;
    uint64_t mid = ah * bl + (al * bl >> 32), cross = al * bh + (uint32_t)mid;
    *low = a * b;
    return ah * bh + (mid >> 32) + (cross >> 32);
}

/* shifts *high, *low left until the highest bit is set, and returns the shift. At least one of them is not 0. */
TT_INLINE int tt_normalise(uint64_t *high, uint64_t *low)
{
    int shift = 0;
    if (*high == 0) {
        *high = *low;
        *low = 0;
        shift = 64;
    }
    for (int step = 32; step > 0; step >>= 1) {
        if (*high >> (64 - step) == 0) {
            *high = *high << step | *low >> (64 - step);
            *low <<= step;
            shift += step;
        }
    }
    return shift;
}

/* mantissa (53 bits) of a finite number other than 0; its lowest bit has the value 2^*e */
TT_INLINE uint64_t tt_mantissa(double x, int *e)
{
    uint64_t m = tt_bits(x) & UINT64_C(0x000fffffffffffff), none = 0;
    *e = (int)(tt_bits(x) >> 52 & 2047) - 1075;
    if (*e > -1075) return m | UINT64_C(0x0010000000000000);
    *e = -1063 - tt_normalise(&m, &none);
    return m >> 11;
}

/* a b + c, computed with integers and rounded once */
TT_COLD double tt_fused_any(double a, double b, double c)
{
    uint64_t high, low, h = 0, l = 0, lost = 0, sign = (tt_bits(a) ^ tt_bits(b)) >> 63, other = tt_bits(c) >> 63, tail;
    int e, k;
    if (!(tt_abs(a) <= DBL_MAX && tt_abs(b) <= DBL_MAX) || a == 0.0 || b == 0.0) return a * b + c;
    if (!(tt_abs(c) <= DBL_MAX)) return c;
    high = tt_mantissa(a, &e) << 11;
    high = tt_product(high, tt_mantissa(b, &k) << 10, &low);
    e += k - 20 - tt_normalise(&high, &low);
    low = low >> 1 | high << 63; /* the highest bit is bit 126, which leaves room for a sum */
    high >>= 1;
    if (c != 0.0) {
        h = tt_mantissa(c, &k) << 10;
        k -= 74;
        if (k > e || (k == e && h > high)) { /* c is the larger one: exchange them */
            uint64_t swap = high;
            high = h, h = swap, l = low, low = 0;
            swap = sign, sign = other, other = swap;
            e ^= k, k ^= e, e ^= k;
        }
        k = e - k < 127 ? e - k : 127;
        if (k >= 64) lost = l, l = h, h = 0, k -= 64;
        if (k > 0) lost |= l << (64 - k), l = l >> k | h << (64 - k), h >>= k;
        l |= lost != 0; /* the bits shifted out are kept as a single bit */
        if (sign == other) {
            low += l;
            high += h + (low < l);
        } else {
            high -= h + (low < l);
            low -= l;
            if ((high | low) == 0) return 0.0;
        }
    }
    e += 1150 - tt_normalise(&high, &low); /* the exponent, as it is stored */
    if (e >= 2047) return tt_from_bits(sign << 63 | UINT64_C(0x7ff0000000000000));
    if (e < 1) { /* subnormal */
        k = 1 - e < 63 ? 1 - e : 63;
        low = (low | high << (64 - k)) != 0;
        high >>= k;
        e = 1;
    }
    tail = (high & 2047) | (low != 0);
    high = (high >> 11) + (tail > 1024 || (tail == 1024 && (high >> 11 & 1) != 0));
    return tt_from_bits(sign << 63 | (((uint64_t)(e - 1) << 52) + high));
}

/* a b + c rounded once, for machines without an instruction for it: the errors of product and sums are added with
 * rounding to odd. Boldo & Melquiond, IEEE Trans. Computers 57 (2008), 462. */
TT_CALLED double tt_fused(double a, double b, double c)
{
    double p = a * b, size = tt_abs(p), sa = tt_abs(a), sb = tt_abs(b), sc = tt_abs(c), ah, bh, al, bl, e, t, tl, v, vl, z, y;
    uint64_t half = UINT64_C(0x4000000), head = UINT64_C(0xfffffffff8000000);
    if (!TT_DOUBLE_FPU || !((size >= 0x1p-900) & (size <= 0x1p1000) & (sc <= 0x1p1000) & (sa <= 0x1p1000)
            & (sb <= 0x1p1000)))
        return tt_fused_any(a, b, c);
    ah = tt_from_bits((tt_bits(a) + half) & head), al = a - ah; /* halves of 26 bits */
    bh = tt_from_bits((tt_bits(b) + half) & head), bl = b - bh;
    e = (((ah * bh - p) + ah * bl) + al * bh) + al * bl;
    t = c + e, y = t - c, tl = (c - (t - y)) + (e - y);
    v = p + t, y = v - p, vl = (p - (v - y)) + (t - y);
    z = tl + vl, y = z - tl, e = (tl - (z - y)) + (vl - y);
    if (e != 0.0 && (tt_bits(z) & 1) == 0) z = tt_from_bits(tt_bits(z) + ((e > 0.0) == (z > 0.0) ? 1 : UINT64_MAX));
    return v + z;
}

/* Payne-Hanek: a = q pi/2 + r for any finite a >= 1, with the results of quarter_turn */
TT_COLD uint64_t tt_far_turn(double a, double *s, double *sl, double *c, double *cl)
{
    static const uint64_t digits[20] = { /* digits of 2 / pi, with 64 bits before the point */
        0, UINT64_C(0xa2f9836e4e441529), UINT64_C(0xfc2757d1f534ddc0), UINT64_C(0xdb6295993c439041),
        UINT64_C(0xfe5163abdebbc561), UINT64_C(0xb7246e3a424dd2e0), UINT64_C(0x06492eea09d1921c),
        UINT64_C(0xfe1deb1cb129a73e), UINT64_C(0xe88235f52ebb4484), UINT64_C(0xe99c7026b45f7e41),
        UINT64_C(0x3991d639835339f4), UINT64_C(0x9c845f8bbdf9283b), UINT64_C(0x1ff897ffde05980f),
        UINT64_C(0xef2f118b5a0a6d1f), UINT64_C(0x6d367ecf27cb09b7), UINT64_C(0x4f463f669e5fea2d),
        UINT64_C(0x7527bac7ebe5f17b), UINT64_C(0x3d0739f78a5292ea), UINT64_C(0x6bfb5fb11f8d5d08),
        UINT64_C(0x56033046fc7b6bab),
    };
    uint64_t word[3], high, mid, low, q, back, m;
    int e, at, by, shift;
    m = tt_mantissa(a, &e);
    at = (e + 62) >> 6, by = (e + 62) & 63; /* from the digit of quarter turns on; whole turns are left out */
    for (int i = 0; i < 3; i++) word[i] = by ? digits[at + i] << by | digits[at + i + 1] >> (64 - by) : digits[at + i];
    high = tt_product(m, word[2], &low);
    low = tt_product(m, word[1], &mid);
    mid += high;
    high = m * word[0] + low + (mid < high);
    q = high >> 62;
    high = high << 2 | mid >> 62; /* fraction of a quarter turn */
    mid <<= 2;
    back = high >> 63;
    if (back) {
        q += 1;
        high = ~high + (mid == 0);
        mid = 0 - mid;
    }
    if ((high | mid) == 0) mid = 1;
    shift = tt_normalise(&high, &mid);
    double f = (double)(high >> 11) * 0x1p-53, g = (double)((high & 2047) << 42 | mid >> 22) * 0x1p-106;
    double y = f * 0x1.921fb54442d18p+0, l = tt_ma(f, 0x1.1a62633145c07p-54, g * 0x1.921fb54442d18p+0);
    double h, unit = tt_from_bits((uint64_t)(1023 - shift) << 52);
    l -= tt_residual(y, f, 0x1.921fb54442d18p+0);
    h = y + l;
    l = ((y - h) + l) * unit;
    m = tt_quarter_turn(h * unit, s, sl, c, cl);
    *sl = tt_ma(l, *c, *sl);
    *cl = tt_ma(-l, *s, *cl);
    if (back) *s = -*s, *sl = -*sl;
    return back ? q - m : q + m;
}

TT_COLD double tt_far_sin(int near, double x, double y)
{
    double s, sl, c, cl;
    if (near || !tt_is_finite(x)) return near ? y : x - x;
    uint64_t q = tt_far_turn(tt_abs(x), &s, &sl, &c, &cl);
    y = q & 1 ? c + cl : s + sl;
    return tt_turn(q & 2 ? -y : y, x);
}

TT_COLD double tt_far_cos(int near, double x, double y)
{
    double s, sl, c, cl;
    if (near || !tt_is_finite(x)) return near ? y : x - x;
    uint64_t q = tt_far_turn(tt_abs(x), &s, &sl, &c, &cl);
    y = q & 1 ? s + sl : c + cl;
    return (q + 1) & 2 ? -y : y;
}

TT_COLD double tt_far_tan(int near, double x, double y)
{
    double s, sl, c, cl, lack;
    if (near || !tt_is_finite(x)) return near ? y : x - x;
    uint64_t q = tt_far_turn(tt_abs(x), &s, &sl, &c, &cl);
    double u = s + sl, ul = (s - u) + sl, v = c + cl, vl = (c - v) + cl;
    y = q & 1 ? tt_quotient(-v, -vl, u, ul, &lack) : tt_quotient(u, ul, v, vl, &lack);
    return tt_turn(y + lack, x);
}

TT_COLD double tt_far_log(int near, double x, double y)
{
    double f, n;
    if (near || (x >= DBL_MIN && x <= DBL_MAX)) return y;
    if (!(x > 0.0)) return x == 0.0 ? -INFINITY : NAN;
    if (x > DBL_MAX) return x;
    n = tt_log_reduce(x * 0x1p54, &f);
    return tt_log_sum(n - 54.0, f, 0.0);
}

TT_COLD double tt_far_log1p(int near, double x, double y)
{
    if (near || (x > -1.0 && x <= DBL_MAX)) return y;
    return x == -1.0 ? -INFINITY : x > 0.0 ? x : NAN;
}

TT_COLD double tt_far_atan2(int near, double y, double x, double r)
{
    double a = tt_abs(x), b = tt_abs(y), large, small, scale;
    if (near) return r;
    if (x != x || y != y) return x + y;
    if (a > DBL_MAX && b > DBL_MAX) a = 1.0, b = 1.0;
    large = a > b ? a : b, small = a > b ? b : a;
    if (small <= large * 0x1p-60) { /* the first-order term is exact, also if it is subnormal */
        if (a >= b && tt_turn(1.0, x) > 0.0) return tt_turn(a == 0.0 ? 0.0 : b / a, y);
        small = a >= b ? 1.0 : 0.0;
        return tt_atan2_near(tt_turn(1.0 - small, y), tt_turn(small, x));
    }
    scale = large > 1.0 ? 0x1p-700 : 0x1p700;
    return tt_atan2_near(tt_turn(b * scale, y), tt_turn(a * scale, x));
}

TT_COLD double tt_far_pow(int near, double x, double y, double r)
{
    double a = tt_abs(x), half = 0.5 * y;
    int whole = floor(y) == y, odd = whole && floor(half) != half;
    if (near) return r;
    if (x == 1.0 || y == 0.0) return 1.0;
    if (x != x || y != y) return x + y;
    if (tt_abs(y) > DBL_MAX) return a == 1.0 ? 1.0 : (a > 1.0) == (y > 0.0) ? INFINITY : 0.0;
    if (x < 0.0 && !whole && a <= DBL_MAX) return NAN;
    if (a == 0.0 || a > DBL_MAX) r = (a == 0.0) == (y < 0.0) ? INFINITY : 0.0;
    else r = tt_pow_near(a < DBL_MIN ? a * 0x1p54 : a, y, a < DBL_MIN ? -54.0 : 0.0);
    return odd ? tt_turn(r, x) : r;
}
