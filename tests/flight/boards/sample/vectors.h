#ifndef VECTORS_H
#define VECTORS_H
#include "autopilot.h"

enum { VECTORS_IN = 4, VECTORS_OUT = 5 };

void vectors_set_in(const double *row, autopilot_in *in);
void vectors_get_out(const autopilot_out *out, double *row);
#endif
