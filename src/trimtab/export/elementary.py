"""Temporary."""


def elementary(lanes: int = 0, names=None) -> str:
    fs = [
        "sin",
        "cos",
        "tan",
        "asin",
        "acos",
        "atan",
        "exp",
        "exp2",
        "expm1",
        "log",
        "log1p",
        "sinh",
        "cosh",
        "tanh",
        "sqrt",
        "cbrt",
        "asinh",
        "acosh",
        "atanh",
        "erf",
        "erfc",
        "floor",
        "ceil",
    ]
    out = ["#include <math.h>"]
    for f in fs:
        out.append(f"static inline double tt_{f}(double x) {{ return {f}(x); }}")
        out.append(f"static inline float tt_{f}f(float x) {{ return {f}f(x); }}")
    for T, s in (("double", ""), ("float", "f")):
        out.append(f"static inline {T} tt_rsqrt{s}({T} x) {{ return 1/sqrt{s}(x); }}")
        out.append(f"static inline {T} tt_logistic{s}({T} x) {{ return 1/(1+exp{s}(-x)); }}")
        out.append(f"static inline {T} tt_round_even{s}({T} x) {{ return rint{s}(x); }}")
        out.append(f"static inline {T} tt_round_away{s}({T} x) {{ return round{s}(x); }}")
        for f in ("pow", "atan2", "fmod"):
            out.append(f"static inline {T} tt_{f}{s}({T} x, {T} y) {{ return {f}{s}(x, y); }}")
        out.append(f"static inline void tt_sincos{s}({T} x, {T} *s, {T} *c) {{ *s = sin{s}(x); *c = cos{s}(x); }}")
    if lanes:
        for f in [*fs, "rsqrt", "logistic", "round_even", "round_away"]:
            out.append(f"static inline vf64 ttv_{f}(vf64 x) {{ vf64 r; EACH_LANE r[l] = tt_{f}(x[l]); return r; }}")
        for f in ("pow", "atan2", "fmod"):
            out.append(
                f"static inline vf64 ttv_{f}(vf64 x, vf64 y) {{ vf64 r; EACH_LANE r[l] = tt_{f}(x[l], y[l]); return r; }}"
            )
        out.append("static inline void ttv_sincos(vf64 x, vf64 *s, vf64 *c) { *s = ttv_sin(x); *c = ttv_cos(x); }")
    return "\n".join(out)
