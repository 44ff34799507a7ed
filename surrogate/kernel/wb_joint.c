/* The linearly implicit law of a joint: DESIGN section 11. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

enum { FREEDOMS = 6, MAX_SWEEPS = 30 }; /* of Jacobi's method: it converges in about six */
/* (omega dt)^2 up to which a mode is explicit: symplectic Euler is stable up to 4, and at 0.5 its
 * frequency is still within 2 %. */
static const double EXPLICIT = 0.5;
/* Of the largest diagonal: off-diagonal elements below it are rounding. */
static const double ROUNDING = 1e-17;

/* a = l l^T in place, the lower triangle; 0 if a is not positive definite. */
static int cholesky(double *a, int n) {
    for (int j = 0; j < n; j++) {
        double pivot = a[n * j + j];
        for (int k = 0; k < j; k++) pivot -= a[n * j + k] * a[n * j + k];
        if (!(pivot > 0) || !isfinite(pivot)) return 0;
        a[n * j + j] = sqrt(pivot);
        for (int i = j + 1; i < n; i++) {
            double sum = a[n * i + j];
            for (int k = 0; k < j; k++) sum -= a[n * i + k] * a[n * j + k];
            a[n * i + j] = sum / a[n * j + j];
            a[n * j + i] = 0;
        }
    }
    return 1;
}

/* Rotate rows and columns p and q of a symmetric matrix, and the columns of its modes. */
static void rotate(double *a, double *modes, int n, int p, int q) {
    double theta = (a[n * q + q] - a[n * p + p]) / (2 * a[n * p + q]);
    double t = (theta >= 0 ? 1 : -1) / (fabs(theta) + sqrt(theta * theta + 1));
    double c = 1 / sqrt(t * t + 1), s = t * c;
    for (int k = 0; k < n; k++) {
        double first = a[n * k + p], second = a[n * k + q];
        a[n * k + p] = c * first - s * second, a[n * k + q] = s * first + c * second;
    }
    for (int k = 0; k < n; k++) {
        double first = a[n * p + k], second = a[n * q + k];
        a[n * p + k] = c * first - s * second, a[n * q + k] = s * first + c * second;
        first = modes[n * k + p], second = modes[n * k + q];
        modes[n * k + p] = c * first - s * second, modes[n * k + q] = s * first + c * second;
    }
}

/* Eigenvalues on the diagonal of a, eigenvectors as columns: Jacobi's method (Golub and Van Loan
 * 2013, 8.5). */
static void diagonalise(double *a, double *modes, int n) {
    double largest = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) modes[n * i + j] = i == j;
    for (int i = 0; i < n; i++) largest = fmax(largest, fabs(a[n * i + i]));
    for (int sweep = 0; sweep < MAX_SWEEPS; sweep++) {
        int turned = 0;
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++)
                if (fabs(a[n * p + q]) > ROUNDING * largest) rotate(a, modes, n, p, q), turned = 1;
        if (!turned) return;
    }
}

/* b = l^T k l of a lower triangle. */
static void congruent(const double *l, const double *k, double *b, int n) {
    double kl[FREEDOMS * FREEDOMS];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int m = j; m < n; m++) sum += k[n * i + m] * l[n * m + j];
            kl[n * i + j] = sum;
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int m = i; m < n; m++) sum += l[n * m + i] * kl[n * m + j];
            b[n * i + j] = sum;
        }
}

/* x = l^-T x, column by column. */
static void solve_transposed(const double *l, double *x, int n) {
    for (int j = 0; j < n; j++)
        for (int i = n - 1; i >= 0; i--) {
            for (int k = i + 1; k < n; k++) x[n * i + j] -= l[n * k + i] * x[n * k + j];
            x[n * i + j] /= l[n * i + i];
        }
}

int wb_joint_rate(int n, const double *stiffness, const double *inverse_mass, double dt,
                  double damping, double *rate) {
    double l[FREEDOMS * FREEDOMS], b[FREEDOMS * FREEDOMS], modes[FREEDOMS * FREEDOMS];
    if (n < 1 || n > FREEDOMS) return WB_NOT_SQUARE;
    for (int i = 0; i < n * n; i++)
        if (!isfinite(stiffness[i]) || !isfinite(inverse_mass[i])) return WB_NOT_FINITE;
    memcpy(l, inverse_mass, (size_t)(n * n) * sizeof(double));
    if (!cholesky(l, n)) return WB_SINGULAR;
    congruent(l, stiffness, b, n);
    diagonalise(b, modes, n);
    solve_transposed(l, modes, n);
    memset(rate, 0, (size_t)(n * n) * sizeof(double));
    for (int mode = 0; mode < n; mode++) {
        double square = fmax(b[n * mode + mode], 0.0); /* rounding, or a part that buckles */
        double step = square * dt * dt;
        double implicit = step > EXPLICIT ? 1 - EXPLICIT / step : 0.0;
        double rate_of_mode = dt * implicit * square + 2 * damping * sqrt(square);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++)
                rate[n * i + j] += rate_of_mode * modes[n * i + mode] * modes[n * j + mode];
    }
    return WB_OK;
}
