/* A quadrotor under a network of 12-64-64-4, as one writes it by hand: 500 steps of 2 ms, semi-implicit Euler.
   Loops run over rows of transposed weights, so that they vectorise; tanh is the C library's. */
#include <math.h>

enum { IN = 12, H = 64, OUT = 4, STEPS = 500 };

static void layer(int n, int m, const double *restrict w, const double *restrict b, const double *restrict x,
                  double *restrict y)
{
    for (int i = 0; i < m; i++) y[i] = 0;
    for (int k = 0; k < n; k++)
        for (int i = 0; i < m; i++) y[i] += w[k * m + i] * x[k];
    for (int i = 0; i < m; i++) y[i] += b[i];
}

void quadrotor(const double *x0, const double *w1, const double *b1, const double *w2, const double *b2,
               const double *w3, const double *b3, double *out)
{
    double p[3], v[3], q[4], w[3], dt = 0.002, g = 9.81, mass = 1.2, arm = 0.18, drag = 0.02;
    const double J[3] = {0.011, 0.012, 0.021};
    for (int i = 0; i < 3; i++) p[i] = x0[i], v[i] = x0[3 + i], w[i] = x0[10 + i];
    for (int i = 0; i < 4; i++) q[i] = x0[6 + i];
    for (int step = 0; step < STEPS; step++) {
        double in[IN] = {p[0], p[1], p[2], v[0], v[1], v[2], q[1], q[2], q[3], w[0], w[1], w[2]};
        double h1[H], h2[H], u[OUT], f[OUT];
        layer(IN, H, w1, b1, in, h1);
        for (int i = 0; i < H; i++) h1[i] = tanh(h1[i]);
        layer(H, H, w2, b2, h1, h2);
        for (int i = 0; i < H; i++) h2[i] = tanh(h2[i]);
        layer(H, OUT, w3, b3, h2, u);
        for (int i = 0; i < OUT; i++) f[i] = mass * g / 4 * (1 + 0.5 * tanh(u[i]));
        double thrust = f[0] + f[1] + f[2] + f[3];
        double torque[3] = {arm * (f[1] - f[3]), arm * (f[2] - f[0]), drag * (f[0] - f[1] + f[2] - f[3])};
        double r[3] = {2 * (q[1] * q[3] + q[0] * q[2]), 2 * (q[2] * q[3] - q[0] * q[1]),
                       1 - 2 * (q[1] * q[1] + q[2] * q[2])};
        for (int i = 0; i < 3; i++) v[i] += dt * (thrust / mass * r[i] - (i == 2 ? g : 0));
        for (int i = 0; i < 3; i++) p[i] += dt * v[i];
        double c[3] = {w[1] * J[2] * w[2] - w[2] * J[1] * w[1], w[2] * J[0] * w[0] - w[0] * J[2] * w[2],
                       w[0] * J[1] * w[1] - w[1] * J[0] * w[0]};
        for (int i = 0; i < 3; i++) w[i] += dt * ((torque[i] - c[i]) / J[i]);
        double d[4] = {-q[1] * w[0] - q[2] * w[1] - q[3] * w[2], q[0] * w[0] + q[2] * w[2] - q[3] * w[1],
                       q[0] * w[1] - q[1] * w[2] + q[3] * w[0], q[0] * w[2] + q[1] * w[1] - q[2] * w[0]};
        for (int i = 0; i < 4; i++) q[i] += 0.5 * dt * d[i];
        double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        for (int i = 0; i < 4; i++) q[i] /= norm;
    }
    for (int i = 0; i < 3; i++) out[i] = p[i], out[3 + i] = v[i], out[10 + i] = w[i];
    for (int i = 0; i < 4; i++) out[6 + i] = q[i];
}
