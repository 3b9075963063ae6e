/* C library functions that exported text calls and for which WebAssembly has no instruction. With -mbulk-memory, the
 * compiler makes a single instruction of each of the two loops. */
#include <math.h>
#include <string.h>

void *memcpy(void *restrict to, const void *restrict from, size_t count)
{
    char *a = to;
    const char *b = from;
    while (count--) *a++ = *b++;
    return to;
}

void *memset(void *to, int value, size_t count)
{
    char *a = to;
    while (count--) *a++ = (char)value;
    return to;
}

double round(double x)
{
    const double whole = trunc(x);
    return fabs(x - whole) >= 0.5 ? whole + copysign(1.0, x) : whole;
}
