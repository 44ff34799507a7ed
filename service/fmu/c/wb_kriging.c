/* The Gaussian process over all rows: surrogate/kriging/compiled.py. MIT license. */
#include "wb_table.h"

#include <math.h>
#include <string.h>

enum { LOADS = 6, PLACES = 7, TERMS = 4, OUTPUTS = 6 };

/* Scaled loads, and the rows' distances by each of them (6, n). */
static void scale_loads(const wb_kriging *k, const double wrench[6], double at[6], double *apart) {
    int n = k->rows;
    for (int a = 0; a < LOADS; a++) {
        const double *x = k->x + (int64_t)a * n;
        double *out = apart + (int64_t)a * n;
        at[a] = (wrench[a] - k->scales[a]) * k->scales[6 + a];
        for (int row = 0; row < n; row++) out[row] = at[a] - x[row];
    }
}

/* Of squared scaled distances: rows that are as near but for rounding, neighbourhood.py. */
static const double TIE = 1e-10;

/* The nearest row over all loads that has a neighbourhood; of equally near ones the first. */
static int nearest(const wb_kriging *k, const wb_share *share, const double *apart,
                   double *distance) {
    const double *rates = k->terms + PLACES * (TERMS - 1);
    int n = k->rows;
    double closest = INFINITY;
    memset(distance, 0, (size_t)n * sizeof(double));
    for (int a = 0; a < LOADS; a++) {
        const double *from = apart + (int64_t)a * n;
        for (int row = 0; row < n; row++) distance[row] += rates[a] * from[row] * from[row];
    }
    for (int row = 0; row < n; row++)
        if (distance[row] < closest && share->least[row] < INFINITY) closest = distance[row];
    for (int row = 0; row < n; row++)
        if (distance[row] <= closest + TIE && share->least[row] < INFINITY) return row;
    return 0;
}

/* The squared scaled distances of one term. */
static void distances(const double *term, const double *apart, int n, double *q) {
    memset(q, 0, (size_t)n * sizeof(double));
    for (int a = 0; a < LOADS; a++) {
        const double *from = apart + (int64_t)a * n;
        if (!(term[a] > 0)) continue;
        for (int row = 0; row < n; row++) q[row] += term[a] * from[row] * from[row];
    }
}

/* Add one term's covariances of a value with the rows' values and slopes to `flat`, (7, n). */
static void add_covariances(const double *term, const double *apart, int n, double *first,
                            double *second, double *flat) {
    distances(term, apart, n, first);
    for (int row = 0; row < n; row++) {
        double root = sqrt(7.0 * first[row]);
        double decay = exp(-root) * term[LOADS];
        flat[row] += (1 + root + 0.4 * root * root + root * root * root / 15) * decay;
        second[row] = 1.4 * (1 + root + root * root / 3) * decay;
    }
    for (int a = 0; a < LOADS; a++) {
        const double *from = apart + (int64_t)a * n;
        double *out = flat + (int64_t)(1 + a) * n;
        if (!(term[a] > 0)) continue;
        for (int row = 0; row < n; row++) out[row] += term[a] * second[row] * from[row];
    }
}

/* sigma squared over the process variance, from the neighbourhood of a row. */
static double squared_deviation(const wb_kriging *k, const wb_share *share, int anchor,
                                const double at[6], const double *flat, double *chosen,
                                double *reduced) {
    int e = share->equations;
    const int32_t *places = share->places + (int64_t)anchor * e;
    const double *column = share->reduce + (int64_t)anchor * e * (e + 1) / 2;
    const double *unsettled = share->unsettled + (int64_t)anchor * e * PLACES;
    double left[PLACES], spent = 0.0, loose = 0.0, prior = 0.0;
    for (int i = 0; i < e; i++) chosen[i] = flat[places[i]], reduced[i] = 0.0;
    for (int j = 0; j < e; j++) { /* a triangle, column after column: vectors run along it */
        double one = chosen[j];
        for (int i = j; i < e; i++) reduced[i] += column[i - j] * one;
        column += e - j;
    }
    for (int a = 0; a < PLACES; a++) left[a] = 0.0;
    for (int i = 0; i < e; i++) {
        for (int a = 0; a < PLACES; a++) left[a] += reduced[i] * unsettled[PLACES * i + a];
        spent += reduced[i] * reduced[i];
    }
    for (int a = 0; a < PLACES; a++) left[a] = (a == 0 ? 1.0 : at[a - 1]) - left[a];
    for (int a = 0; a < PLACES; a++)
        for (int b = 0; b < PLACES; b++)
            loose += left[a] * share->mean_covariance[PLACES * a + b] * left[b];
    for (int term = 0; term < TERMS; term++) prior += k->terms[PLACES * term + LOADS];
    return fmax(prior - spent, share->least[anchor]) + loose;
}

/* Sums of covariances (7, n) with the weights (7, n, 6): one number an output. */
static void weigh(const wb_kriging *k, const double *flat, double told[6]) {
    int64_t count = (int64_t)PLACES * k->rows;
    for (int q = 0; q < OUTPUTS; q++) told[q] = 0.0;
    for (int64_t i = 0; i < count; i++)
        for (int q = 0; q < OUTPUTS; q++) told[q] += flat[i] * k->weights[OUTPUTS * i + q];
}

/* `_is_known`: whether the error at scaled loads with a posterior deviation is known. */
static int is_known(const wb_kriging *k, const wb_share *share, double sigma, const double at[6]) {
    for (int a = 0; a < LOADS; a++)
        if (!(k->span[a] <= at[a] && at[a] <= k->span[LOADS + a])) return 0;
    return sigma <= share->sigma[share->levels];
}

/* `_factor`: what a deviation is multiplied by for an error bar. */
static double factor_of(const wb_share *share, double sigma, int q) {
    int last = share->levels - 1, n = 0;
    const double *f = share->factors + q, *s = share->sigma;
    if (sigma >= s[last]) return f[OUTPUTS * last];
    if (sigma <= s[0]) return f[0];
    while (s[n + 1] <= sigma) n++;
    return (f[OUTPUTS * (n + 1)] - f[OUTPUTS * n]) / (s[n + 1] - s[n]) * (sigma - s[n])
           + f[OUTPUTS * n];
}

/* `_values`: displacement and 95 % bar, m and rad. */
void wb_kriging_values(const wb_kriging *k, wb_workspace *work, const double wrench[6],
                       double displacement[6], double bar[6]) {
    const double *offset = k->scales + 12, *spread = k->scales + 18, *over = k->scales + 24;
    const double *lost = k->scales + 30;
    double at[LOADS], told[OUTPUTS], sigma[OUTPUTS] = {0};
    int n = k->rows;
    scale_loads(k, wrench, at, work->apart);
    memset(work->across, 0, (size_t)PLACES * n * sizeof(double));
    for (int term = 0; term < TERMS; term++)
        add_covariances(k->terms + PLACES * term, work->apart, n, work->first, work->second,
                        work->across);
    weigh(k, work->across, told);
    for (int s = 0; s < k->shares; s++) {
        const wb_share *share = &k->share[s];
        int anchor = nearest(k, share, work->apart, work->first);
        double own = sqrt(squared_deviation(k, share, anchor, at, work->across, work->chosen,
                                            work->reduced));
        for (int q = 0; q < OUTPUTS; q++)
            if (share->outputs[q])
                sigma[q] = is_known(k, share, own, at) ? own * factor_of(share, own, q) : NAN;
    }
    for (int q = 0; q < OUTPUTS; q++) {
        double value = told[q] + k->coefficients[q];
        for (int a = 0; a < LOADS; a++) value += at[a] * k->coefficients[OUTPUTS * (1 + a) + q];
        displacement[q] = value * spread[q] + offset[q];
        double size = (fabs(value) + 1.0) * spread[q] + fabs(offset[q]);
        double least = fmax(*k->floor * size, lost[q]), wide = sigma[q] * over[q];
        bar[q] = wide < least ? least : wide; /* a bar that is not a number stays none */
    }
}

/* Add one term's covariances of the slope by load a with the rows' values and slopes. */
static void add_slope(const double *term, const double *apart, int n, const double *first,
                      const double *second, int a, double *flat) {
    const double *from = apart + (int64_t)a * n;
    double twice = 2 * term[a];
    if (!(term[a] > 0)) return;
    for (int row = 0; row < n; row++) {
        flat[row] += twice * first[row] * from[row];
        flat[(int64_t)(1 + a) * n + row] -= twice * first[row];
    }
    for (int b = 0; b < LOADS; b++) {
        /* The later load first, as the symmetric half that Python computes has it. */
        const double *late = apart + (int64_t)(a > b ? a : b) * n;
        const double *early = apart + (int64_t)(a > b ? b : a) * n;
        double *out = flat + (int64_t)(1 + b) * n;
        double four = 2 * (2 * term[a > b ? a : b]) * term[a > b ? b : a];
        if (!(term[b] > 0)) continue;
        for (int row = 0; row < n; row++) out[row] -= four * second[row] * late[row] * early[row];
    }
}

/* The two derivatives of one term's correlation by the squared distance. */
static void bend(const double *term, const double *apart, int n, double *first, double *second) {
    distances(term, apart, n, first);
    for (int row = 0; row < n; row++) {
        double root = sqrt(7.0 * first[row]);
        double decay = exp(-root) * term[LOADS];
        first[row] = -0.7 * (1 + root + root * root / 3) * decay;
        second[row] = 49.0 / 60 * (1 + root) * decay;
    }
}

/* The derivative of `_answers`: du/dw, 6 x 6, SI. */
void wb_kriging_derivative(const wb_kriging *k, wb_workspace *work, const double wrench[6],
                           double derivative[36]) {
    const double *rate = k->scales + 6, *spread = k->scales + 18;
    double at[LOADS], told[OUTPUTS];
    int n = k->rows;
    scale_loads(k, wrench, at, work->apart);
    for (int a = 0; a < LOADS; a++) {
        memset(work->across, 0, (size_t)PLACES * n * sizeof(double));
        for (int term = 0; term < TERMS; term++) {
            const double *own = k->terms + PLACES * term;
            if (!(own[a] > 0)) continue;
            bend(own, work->apart, n, work->first, work->second);
            add_slope(own, work->apart, n, work->first, work->second, a, work->across);
        }
        weigh(k, work->across, told);
        for (int q = 0; q < OUTPUTS; q++) {
            double slope = told[q] + k->coefficients[OUTPUTS * (1 + a) + q];
            derivative[6 * q + a] = slope * spread[q] * rate[a] + k->tangent[6 * q + a];
        }
    }
}
