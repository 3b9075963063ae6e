/* Which pulse stands for which value of the command: written with the scenario, in outputs.c and commands.c. */
#ifndef OUTPUT_TABLE_H
#define OUTPUT_TABLE_H
#include "failsafe.h"
#include "outputs.h"
#include "world.h"

/* One output: values, rising, and the counts of the pulse at each; between them linear, beyond them the ends. */
typedef struct {
    int n;
    const double *values, *counts;
} output_table;

extern const output_table output_tables[CHANNELS];

/* The number of the command behind each output: as the failsafe passes it on, as a world is told, and the safe one. */
double output_value(const failsafe_out *out, int channel);
void output_tell(world_in *world, int channel, double value);
void output_rest(failsafe_in *in);
#endif
