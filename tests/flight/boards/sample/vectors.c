#include "vectors.h"

void vectors_set_in(const double *row, autopilot_in *in) {
    in->acceleration = (autopilot_real)row[0];
    in->position = (autopilot_real)row[1];
    in->heading = (autopilot_real)row[2];
    in->fresh = (int32_t)row[3];
}

void vectors_get_out(const autopilot_out *out, double *row) {
    row[0] = (double)out->force[0];
    row[1] = (double)out->force[1];
    row[2] = (double)out->speed;
    row[3] = (double)out->sigma;
    row[4] = (double)out->mode;
}
