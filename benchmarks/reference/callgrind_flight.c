/* Program for instructions.py: the first n instants of a flight that trimtab generated, as C or, over lanes, as C++.
 *
 * job.h is the struct of the generated text. The file `input` holds doubles shared and own, then t and h (int64) and row
 * (int32); SHARED, OWN, TICKS, RUNS and COUNT are their lengths, and those of the last values.
 */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "job.h"

#ifdef __cplusplus
extern "C"
#endif
int32_t trimtab_fly(job *j, int32_t threads);

int main(int argc, char **argv)
{
    static double shared[SHARED + 1], own[OWN + 1], final[RUNS * COUNT];
    static int64_t t[TICKS], h[TICKS];
    static int32_t row[TICKS];
    FILE *f = fopen("input", "rb");
    if (!f)
        return 1;
    size_t read = fread(shared, 8, SHARED, f) + fread(own, 8, OWN, f);
    read += fread(t, 8, TICKS, f) + fread(h, 8, TICKS, f) + fread(row, 4, TICKS, f);
    fclose(f);
    if (read != SHARED + OWN + 3 * TICKS)
        return 1;
    job j = {shared, own, OWN / RUNS, RUNS, argc > 1 ? atoi(argv[1]) : TICKS, 0, t, h, row, 0, 0, final, 0, 0, 0};
    trimtab_fly(&j, 1);
    for (int i = 0; i < COUNT; i++)
        printf("%.17g\n", final[i]);
    return 0;
}
