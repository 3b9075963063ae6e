/* C library functions that exported text calls. Each is an instruction of WebAssembly, or is defined in library.c. */
#ifndef TRIMTAB_MATH_H
#define TRIMTAB_MATH_H

#define INFINITY (__builtin_inff())
#define NAN (__builtin_nanf(""))
#define isnan(x) __builtin_isnan(x)
#define isinf(x) __builtin_isinf_sign(x)
#define signbit(x) __builtin_signbit(x)

double fabs(double);
double sqrt(double);
double floor(double);
double ceil(double);
double trunc(double);
double rint(double);
double copysign(double, double);
double round(double);

#endif
