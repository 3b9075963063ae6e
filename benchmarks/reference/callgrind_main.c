/* Program for instructions.py: n ticks of hover_c.c, or of hover_simd.cpp where W (lanes) is defined. */
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#ifdef W
extern "C" void sim_block(const double *gains, uint32_t k0, const uint32_t *k1, int n, double *out);
#else
#define W 1
void sim_sum(const double *gains, const uint32_t *key, int n, double *out);
#endif

int main(int argc, char **argv)
{
    const double gains[2] = {1, 2.5};
    const int n = argc > 1 ? atoi(argv[1]) : 15000;
    double out[14 * W];
#ifdef __cplusplus
    const uint32_t runs[8] = {0, 1, 2, 3, 4, 5, 6, 7};
    sim_block(gains, 7, runs, n, out);
#else
    const uint32_t key[2] = {7, 0};
    sim_sum(gains, key, n, out);
#endif
    for (int i = 0; i < 14; i++)
        printf("%.17g\n", out[i]);
    return 0;
}
