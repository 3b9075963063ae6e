/* Vectors of a program, with one run in each lane. With TT_HALVES, the lanes hold numbers of 32 bits: there are then twice
 * as many lanes as doubles in a vector of the elementary functions (vf64), and a truth value has 32 bits. */
#define EACH_LANE for (int l = 0; l < LANES; l++)
#if TT_HALVES
#define LANES (2 * TT_LANES)
#else
#define LANES TT_LANES
#endif
typedef int32_t vi32 __attribute__((vector_size(4 * LANES)));
typedef uint32_t vu32 __attribute__((vector_size(4 * LANES)));
typedef float vf32 __attribute__((vector_size(4 * LANES)));
typedef int64_t wi64 __attribute__((vector_size(8 * LANES)));
typedef uint64_t wu64 __attribute__((vector_size(8 * LANES)));
typedef double wf64 __attribute__((vector_size(8 * LANES)));
#if TT_HALVES
typedef vi32 vmask; /* false: 0, true: -1 */
typedef int32_t tt_mask;
#define MASK_32(m) (m)
#define MASK_64(m) __builtin_convertvector(m, wi64)
#define MASK_OF_32(test) ((vmask)(test))
#define MASK_OF_64(test) __builtin_convertvector(test, vmask)
typedef float tt_half __attribute__((vector_size(4 * TT_LANES)));
typedef union {
    vf32 whole;
    tt_half half[2];
} tt_halves;

/* numbers of the first or the second half of the lanes */
static inline __attribute__((always_inline, unused)) vf64 tt_part(vf32 x, int second)
{
#if !defined(__clang__) && __GNUC__ < 12
    tt_halves both = {x};
    return __builtin_convertvector(both.half[second], vf64);
#elif TT_LANES == 4
    return second ? __builtin_convertvector(__builtin_shufflevector(x, x, 4, 5, 6, 7), vf64)
                  : __builtin_convertvector(__builtin_shufflevector(x, x, 0, 1, 2, 3), vf64);
#else
    return second ? __builtin_convertvector(__builtin_shufflevector(x, x, 8, 9, 10, 11, 12, 13, 14, 15), vf64)
                  : __builtin_convertvector(__builtin_shufflevector(x, x, 0, 1, 2, 3, 4, 5, 6, 7), vf64);
#endif
}

static inline __attribute__((always_inline, unused)) vf32 tt_join(vf64 first, vf64 second)
{
    tt_half a = __builtin_convertvector(first, tt_half), b = __builtin_convertvector(second, tt_half);
#if !defined(__clang__) && __GNUC__ < 12
    tt_halves both;
    both.half[0] = a;
    both.half[1] = b;
    return both.whole;
#elif TT_LANES == 4
    return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
#else
    return __builtin_shufflevector(a, b, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
#endif
}

static inline __attribute__((always_inline, unused)) bool tt_any(vmask m)
{
    int32_t any = 0;
    EACH_LANE any |= m[l];
    return any != 0;
}
#define OF_DOUBLE(f, x) tt_join(f(tt_part(x, 0)), f(tt_part(x, 1)))
#define OF_DOUBLES(f, x, y) tt_join(f(tt_part(x, 0), tt_part(y, 0)), f(tt_part(x, 1), tt_part(y, 1)))
#else
typedef vi64 vmask; /* false: 0, true: -1 */
typedef int64_t tt_mask;
#define MASK_32(m) __builtin_convertvector(m, vi32)
#define MASK_64(m) (m)
#define MASK_OF_32(test) __builtin_convertvector(test, vmask)
#define MASK_OF_64(test) ((vmask)(test))
#define tt_any(m) ttv_any(m)
#define OF_DOUBLE(f, x) __builtin_convertvector(f(__builtin_convertvector(x, vf64)), vf32)
#define OF_DOUBLES(f, x, y) \
    __builtin_convertvector(f(__builtin_convertvector(x, vf64), __builtin_convertvector(y, vf64)), vf32)
#endif
