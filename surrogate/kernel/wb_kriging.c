/* The Gaussian process over all rows. MIT license.
 *
 * Rows are innermost and padded to whole vectors; rows of the padding weigh nothing. Sums run in
 * WB_LANES partial sums, in the order of the rows.
 */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

/* Where the C library can choose at load time, processors with AVX2 run these loops four numbers at a
 * time. The operations on each number are the same, without fused multiply-add: so are the bits. */
#if defined(WB_VECTORS) /* the compiler's command says */
#elif defined(__GNUC__) && defined(__x86_64__) && defined(__GLIBC__)
#define WB_VECTORS __attribute__((target_clones("default", "avx2")))
#else
#define WB_VECTORS
#endif

/* Of squared scaled distances: rows as near as this are equally near, and the first is taken, so
 * that rounding does not choose. */
static const double TIE = 1e-10;

/* exp(-a) for a >= 0, without branches so that loops become vectors; below 1.2 units in the last
 * place (measured over 1e7 arguments against 80-bit numbers). exp(-a) = 2^k exp(r), |r| <= ln 2 / 2;
 * Taylor's series to r^13 leaves 4e-18. Above 700 the result is exp(-700), 1e-304. */
static inline double decay_of(double a) {
    const double shift = 6755399441055744.0; /* 1.5 * 2^52: adding it rounds to a whole number */
    double x = a > 700.0 ? -700.0 : -a;
    double whole = x * 1.4426950408889634 + shift, k = whole - shift;
    double r = (x - k * 6.93147180369123816490e-01) - k * 1.90821492927058770002e-10;
    double p = 1.0 / 6227020800.0;
    p = p * r + 1.0 / 479001600.0;
    p = p * r + 1.0 / 39916800.0;
    p = p * r + 1.0 / 3628800.0;
    p = p * r + 1.0 / 362880.0;
    p = p * r + 1.0 / 40320.0;
    p = p * r + 1.0 / 5040.0;
    p = p * r + 1.0 / 720.0;
    p = p * r + 1.0 / 120.0;
    p = p * r + 1.0 / 24.0;
    p = p * r + 1.0 / 6.0;
    p = p * r + 0.5;
    p = p * r + 1.0;
    p = p * r + 1.0;
    union { double value; uint64_t bits; } scale;
    scale.value = whole;
    scale.bits = (scale.bits + 1023) << 52; /* the low bits of `whole` are k */
    return p * scale.value;
}

/* The sum of products in WB_LANES partial sums. */
WB_VECTORS static double product(const double *restrict a, const double *restrict b, int count) {
    double sum[WB_LANES] = {0};
    for (int i = 0; i < count; i += WB_LANES) {
#pragma omp simd
        for (int lane = 0; lane < WB_LANES; lane++) sum[lane] += a[i + lane] * b[i + lane];
    }
    return ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
}

/* Scaled loads, and the rows' distances from them by each load (n, stride). */
static void scale_loads(const wb_kriging *k, int inputs, const double *wrench, double *at,
                        double *restrict apart) {
    for (int a = 0; a < inputs; a++) {
        const double *restrict x = k->x + (int64_t)a * k->stride;
        double *restrict out = apart + (int64_t)a * k->stride;
        at[a] = (wrench[a] - k->centre[a]) * k->rate[a];
        for (int row = 0; row < k->stride; row++) out[row] = at[a] - x[row];
    }
}

/* Squared scaled distances by the loads that have a rate, added to q (stride). */
static void add_distances(const double *rates, int inputs, const double *restrict apart, int stride,
                          double *restrict q) {
    for (int a = 0; a < inputs; a++) {
        const double *restrict from = apart + (int64_t)a * stride;
        double rate = rates[a];
        if (!(rate > 0)) continue;
        for (int row = 0; row < stride; row++) q[row] += rate * from[row] * from[row];
    }
}

/* The nearest row over all loads that has a neighbourhood; of equally near ones the first. */
WB_VECTORS static int nearest(const wb_kriging *k, const wb_factor *factor, int inputs, const double *apart,
                   double *restrict distance) {
    double closest = INFINITY;
    memcpy(distance, factor->penalty, (size_t)k->stride * sizeof(double));
    add_distances(factor->rates, inputs, apart, k->stride, distance);
    for (int row = 0; row < k->stride; row++)
        closest = distance[row] < closest ? distance[row] : closest;
    for (int row = 0; row < k->stride; row++)
        if (distance[row] <= closest + TIE) return row;
    return 0; /* a wrench that is not a number */
}

/* Add factor * from * by to `out`. */
static inline void add_product(double factor, const double *restrict from, const double *restrict by,
                               int stride, double *restrict out) {
    for (int row = 0; row < stride; row++) out[row] += factor * from[row] * by[row];
}

/* Where the second derivatives by loads a and b begin: the pairs of loads follow each other, a <= b. */
static double *pair_of(double *flat, int inputs, int a, int b, int stride) {
    int low = a < b ? a : b, high = a < b ? b : a;
    return flat + (int64_t)(1 + inputs + low * inputs - low * (low - 1) / 2 + high - low) * stride;
}

/* Add `by` times the products of each two scaled distances to the pairs of loads. */
static inline void add_pairs(const double *term, int inputs, const double *restrict apart, int stride,
                             const double *restrict by, double *restrict flat) {
    double *restrict out = flat + (int64_t)(1 + inputs) * stride;
    for (int a = 0; a < inputs; a++)
        for (int b = a; b < inputs; b++, out += stride) {
            const double *restrict by_a = apart + (int64_t)a * stride;
            const double *restrict by_b = apart + (int64_t)b * stride;
            double both = term[a] * term[b];
            if (!(both > 0)) continue;
            for (int row = 0; row < stride; row++) out[row] += both * by[row] * by_a[row] * by_b[row];
        }
}

/* Add one term's covariances of a value with the rows' values and slopes to `flat` (1 + n, stride):
 * with 7/2 the correlation of Matern is (1 + a + 2/5 a^2 + a^3/15) exp(-a), a^2 = 7 q. With the rows'
 * second derivatives it is that of 9/2, (1 + a + 3/7 a^2 + 2/21 a^3 + a^4/105) exp(-a), a^2 = 9 q.
 * `first` is -2 times its derivative by q, `second` 4 times its second derivative, `third` -8 times
 * its third derivative, which rows with second derivatives need. */
WB_VECTORS static void add_covariances(const double *term, int inputs, const double *restrict apart,
                                       int stride, int has_second, double *restrict first,
                                       double *restrict second, double *restrict third,
                                       double *restrict flat) {
    double weight = term[inputs];
    memset(first, 0, (size_t)stride * sizeof(double));
    add_distances(term, inputs, apart, stride, first);
    if (!has_second) for (int row = 0; row < stride; row++) {
        double a = sqrt(7.0 * first[row]), decay = decay_of(a) * weight;
        flat[row] += (1 + a + 0.4 * a * a + a * a * a * (1.0 / 15)) * decay;
        first[row] = 1.4 * (1 + a + a * a * (1.0 / 3)) * decay;
        second[row] = 49.0 / 15 * (1 + a) * decay;
    }
    else for (int row = 0; row < stride; row++) {
        double a = sqrt(9.0 * first[row]), decay = decay_of(a) * weight, square = a * a;
        flat[row] += (1 + a + square * (3.0 / 7) + square * a * (2.0 / 21)
                      + square * square * (1.0 / 105)) * decay;
        first[row] = 9.0 / 7 * (1 + a + 0.4 * square + square * a * (1.0 / 15)) * decay;
        second[row] = 81.0 / 35 * (1 + a + square * (1.0 / 3)) * decay;
        third[row] = 243.0 / 35 * (1 + a) * decay;
    }
    for (int a = 0; a < inputs; a++)
        if (term[a] > 0)
            add_product(term[a], first, apart + (int64_t)a * stride, stride, flat + (int64_t)(1 + a) * stride);
    if (has_second) add_pairs(term, inputs, apart, stride, second, flat);
    if (has_second)
        for (int a = 0; a < inputs; a++) {
            double *restrict out = pair_of(flat, inputs, a, a, stride), rate = term[a];
            if (rate * rate > 0)
                for (int row = 0; row < stride; row++) out[row] -= rate * first[row];
        }
}

/* A triangle times covariances: panels of WB_PANEL rows, each column after column. */
WB_VECTORS static void reduce(const double *restrict panel, const double *restrict chosen, int padded,
                   double *restrict reduced) {
    for (int top = 0; top < padded; top += WB_PANEL) {
        double sum[WB_PANEL] = {0};
        for (int column = 0; column < top + WB_PANEL; column++, panel += WB_PANEL) {
            double factor = chosen[column];
#pragma omp simd
            for (int lane = 0; lane < WB_PANEL; lane++) sum[lane] += panel[lane] * factor;
        }
        memcpy(reduced + top, sum, sizeof sum);
    }
}

/* sigma squared over the process variance, from the neighbourhood of a row. */
static double squared_deviation(const wb_kriging *k, const wb_factor *factor, int inputs, int anchor,
                                const double *at, const wb_work *work) {
    int padded = factor->padded, terms = inputs + 1;
    int64_t number = factor->number[anchor], triangle = (int64_t)padded * (padded + WB_PANEL) / 2;
    const int32_t *equations = factor->equations + number * padded;
    const double *trend_terms = factor->trend + number * terms * padded;
    double mean_terms[WB_MAX + 1], trend = 0.0, prior = 0.0;
    for (int i = 0; i < padded; i++) work->chosen[i] = work->flat[equations[i]];
    reduce(factor->panels + number * triangle, work->chosen, padded, work->reduced);
    for (int a = 0; a < terms; a++)
        mean_terms[a] = (a == 0 ? 1.0 : at[a - 1])
                  - product(work->reduced, trend_terms + (int64_t)a * padded, padded);
    for (int a = 0; a < terms; a++)
        for (int b = 0; b < terms; b++)
            trend += mean_terms[a] * factor->mean_covariance[terms * a + b] * mean_terms[b];
    for (int term = 0; term < k->terms; term++) prior += factor->term[terms * term + inputs];
    double explained = product(work->reduced, work->reduced, padded);
    return fmax(prior - explained, factor->min_variance[anchor]) + trend;
}

/* The row whose neighbourhood gives sigma: wrenches of one anchor read the same memory. */
int wb_anchor(const wb_table *t, const wb_kriging *k, const double *wrench, wb_work *work) {
    double at[WB_MAX];
    scale_loads(k, t->inputs, wrench, at, work->apart);
    return nearest(k, k->factor, t->inputs, work->apart, work->first);
}

/* Whether a factor has the covariance of the one before it. */
static int as_before(const wb_kriging *k, int n, int s) {
    size_t size = (size_t)(k->terms * (n + 1)) * sizeof(double);
    return s > 0 && s < k->factors && !memcmp(k->factor[s].term, k->factor[s - 1].term, size);
}

/* The derivatives of each term's correlation, as `add_covariances` gives them. */
static double *term_of(const wb_kriging *k, wb_work *work, int term) {
    return work->wide + (int64_t)3 * term * k->stride;
}

/* The covariances of a value with all rows. */
static void covary(const wb_kriging *k, const wb_factor *factor, int n, wb_work *work) {
    memset(work->flat, 0, (size_t)(k->per_row * k->stride) * sizeof(double));
    for (int term = 0; term < k->terms; term++) {
        double *first = term_of(k, work, term);
        add_covariances(factor->term + (n + 1) * term, n, work->apart, k->stride, k->has_second, first,
                        first + k->stride, first + 2 * k->stride, work->flat);
    }
    work->of = factor;
}

/* The value of an output by these, over its spread. */
static double value_of(const wb_table *t, const wb_kriging *k, const wb_work *work,
                       const double *at, int q) {
    int n = t->inputs, m = t->outputs, count = k->per_row * k->stride;
    double value = product(work->flat, k->weights + (int64_t)q * count, count);
    value += k->coefficients[q];
    for (int a = 0; a < n; a++) value += at[a] * k->coefficients[m * (1 + a) + q];
    return value;
}

/* The scaled loads, values over their spreads, and sigma of each factor over its process deviation;
 * `values` or `sigma` may be NULL. */
static void explore(const wb_table *t, const wb_kriging *k, wb_work *work, const double *wrench,
                    double *at, double *values, double *sigma) {
    int n = t->inputs;
    scale_loads(k, n, wrench, at, work->apart);
    for (int s = 0; s < k->factors; s++) {
        const wb_factor *factor = &k->factor[s];
        if (!as_before(k, n, s)) covary(k, factor, n, work);
        if (values)
            for (int q = 0; q < t->outputs; q++)
                if (factor->outputs[q]) values[q] = value_of(t, k, work, at, q);
        if (!sigma) continue;
        int anchor = nearest(k, factor, n, work->apart, work->first);
        sigma[s] = sqrt(squared_deviation(k, factor, n, anchor, at, work));
    }
}

/* Whether rows have loads as large as these at once: besides the main load, and besides those that
 * one term sees (the last term sees all). */
static int are_shown_together(const wb_kriging *k, int inputs, const double *at) {
    double largest = 0.0, second = 0.0, least = INFINITY;
    for (int a = 0; a < inputs; a++) {
        double load = fabs(at[a] + k->centre[a] * k->rate[a]);
        second = fmax(second, fmin(load, largest)), largest = fmax(load, largest);
    }
    for (int i = 0; i < k->terms - 1; i++) {
        const double *term = k->term + (inputs + 1) * i;
        double most = 0.0;
        for (int a = 0; a < inputs; a++)
            if (!(term[a] > 0.0)) most = fmax(most, fabs(at[a] + k->centre[a] * k->rate[a]));
        least = fmin(least, most);
    }
    return second <= k->together[0] && least <= k->together[1];
}

/* Why the errors of an answer are not known. */
void wb_kriging_reasons(const wb_table *t, const wb_kriging *k, wb_work *work, const double *w,
                        wb_result *a) {
    double at[WB_MAX] = {0}, sigma[WB_MAX];
    int before = a->reasons, far = -1;
    for (int s = 0; s < k->factors; s++)
        if (!(*k->factor[s].max_sigma > 0)) {
            wb_add_reason(a, WB_REASON_ERRORS_UNKNOWN);
            return;
        }
    explore(t, k, work, w, at, NULL, sigma);
    for (int s = 0; s < k->factors; s++)
        if (!(sigma[s] <= *k->factor[s].max_sigma)) far = s;
    for (int load = 0; load < t->inputs; load++) {
        if (k->span[load] <= at[load] && at[load] <= k->span[t->inputs + load]) continue;
        wb_reason *reason = wb_add_reason(a, WB_REASON_BEYOND_SPAN);
        reason->index = load, reason->value = w[load];
    }
    if (a->reasons > before) return;
    if (!are_shown_together(k, t->inputs, at)) {
        wb_add_reason(a, WB_REASON_INTERACTION);
        return;
    }
    if (far < 0) return;
    wb_reason *reason = wb_add_reason(a, WB_REASON_TOO_FAR);
    reason->value = sigma[far], reason->limit = *k->factor[far].max_sigma;
}

/* Outputs alone, m and rad. */
void wb_kriging_outputs(const wb_table *t, const wb_kriging *k, wb_work *work,
                        const double *wrench, double *outputs) {
    double at[WB_MAX];
    memset(outputs, 0, (size_t)t->outputs * sizeof(double));
    explore(t, k, work, wrench, at, outputs, NULL);
    for (int q = 0; q < t->outputs; q++) outputs[q] = outputs[q] * k->spread[q] + k->offset[q];
}

/* Outputs and 95 % errors, m and rad. */
void wb_kriging_values(const wb_table *t, const wb_kriging *k, wb_work *work,
                         const double *wrench, double *outputs, double *error) {
    int n = t->inputs, m = t->outputs;
    double at[WB_MAX], sigma[WB_MAX], values[WB_MAX] = {0}, wide[WB_MAX] = {0};
    explore(t, k, work, wrench, at, values, sigma);
    int spanned = 1; /* beyond the rows errors are not known */
    for (int a = 0; a < n; a++) spanned &= k->span[a] <= at[a] && at[a] <= k->span[n + a];
    spanned &= are_shown_together(k, n, at);
    for (int s = 0; s < k->factors; s++) { /* nor where rows left out do not show them */
        const wb_factor *factor = &k->factor[s];
        for (int q = 0; q < m; q++)
            if (factor->outputs[q])
                wide[q] = spanned && sigma[s] <= *factor->max_sigma ? sigma[s] * factor->scale[q] : NAN;
    }
    for (int q = 0; q < m; q++) {
        outputs[q] = values[q] * k->spread[q] + k->offset[q];
        double bar = wide[q] * k->deviation[q];
        error[q] = sqrt(bar * bar + k->floor[q] * k->floor[q]); /* NaN stays NaN */
    }
}

/* Add one term's covariances of the slope along a direction d of scaled loads with the rows' values,
 * slopes and, with `has_second`, second derivatives. `along` is the sum of t_c d_c apart_c. */
WB_VECTORS static void add_slope(const double *term, int inputs, const double *restrict apart, int stride,
                                 int has_second, const double *restrict first, const double *direction,
                                 double *restrict along, double *restrict spare, double *restrict flat) {
    const double *restrict second = first + stride, *restrict third = second + stride;
    memset(along, 0, (size_t)stride * sizeof(double));
    for (int a = 0; a < inputs; a++) {
        const double *restrict from = apart + (int64_t)a * stride;
        double rate = term[a] * direction[a];
        if (rate != 0)
            for (int row = 0; row < stride; row++) along[row] += rate * from[row];
    }
    add_product(-1, first, along, stride, flat);
    for (int row = 0; row < stride; row++) spare[row] = second[row] * along[row];
    for (int a = 0; a < inputs; a++) {
        double *restrict out = flat + (int64_t)(1 + a) * stride, rate = term[a] * direction[a];
        if (!(term[a] > 0)) continue;
        add_product(-term[a], spare, apart + (int64_t)a * stride, stride, out);
        if (rate != 0)
            for (int row = 0; row < stride; row++) out[row] += rate * first[row];
    }
    if (!has_second) return;
    for (int a = 0; a < inputs; a++) {
        double *restrict out = pair_of(flat, inputs, a, a, stride);
        if (term[a] > 0)
            for (int row = 0; row < stride; row++) out[row] += term[a] * spare[row];
        for (int b = 0; b < inputs; b++) {
            double both = (a == b ? 2 : 1) * term[a] * term[b] * direction[b];
            if (both != 0) add_product(both, second, apart + (int64_t)a * stride, stride,
                                       pair_of(flat, inputs, a, b, stride));
        }
    }
    for (int row = 0; row < stride; row++) spare[row] = -third[row] * along[row];
    add_pairs(term, inputs, apart, stride, spare, flat);
}

/* Whether a factor, from `s` to `end`, answers output q: a scene's table has those of the outputs
 * that it reads. */
static int answers(const wb_kriging *k, int s, int end, int q) {
    for (; s < end; s++)
        if (k->factor[s].outputs[q]) return 1;
    return 0;
}

/* The slopes (m), SI, along a direction of the inputs, SI, of outputs of factors from `s` to `end`. */
static void slopes_along(const wb_table *t, const wb_kriging *k, int s, int end, wb_work *work,
                         const double *direction, double *slopes) {
    int n = t->inputs, m = t->outputs, count = k->per_row * k->stride;
    double scaled[WB_MAX];
    for (int a = 0; a < n; a++) scaled[a] = direction[a] * k->rate[a];
    memset(work->flat, 0, (size_t)count * sizeof(double));
    for (int term = 0; term < k->terms; term++)
        add_slope(k->factor[s].term + (n + 1) * term, n, work->apart, k->stride, k->has_second,
                  term_of(k, work, term), scaled, work->first, work->second, work->flat);
    for (int q = 0; q < m; q++) {
        if (!answers(k, s, end, q)) continue;
        double slope = product(work->flat, k->weights + (int64_t)q * count, count);
        for (int a = 0; a < n; a++) slope += k->coefficients[m * (1 + a) + q] * scaled[a];
        slopes[q] = slope * k->spread[q];
        for (int a = 0; a < n; a++) /* loads that take no part: the rows' mean tangent, or NaN */
            if (direction[a] != 0.0) slopes[q] += k->tangent[n * q + a] * direction[a];
    }
}

/* The derivatives (m, count), SI, along directions (count, n) of the inputs, SI. What an answer to
 * the same wrench has left is used. */
static void derive(const wb_table *t, const wb_kriging *k, wb_work *work, const double *wrench,
                   int count, const double *directions, double *derivatives) {
    double at[WB_MAX], slopes[WB_MAX];
    memset(derivatives, 0, (size_t)(count * t->outputs) * sizeof(double));
    scale_loads(k, t->inputs, wrench, at, work->apart);
    for (int s = 0, end = 1; s < k->factors; s = end++) { /* factors of one covariance together */
        while (as_before(k, t->inputs, end)) end++;
        if (work->of != &k->factor[s]) covary(k, &k->factor[s], t->inputs, work);
        for (int i = 0; i < count; i++) {
            slopes_along(t, k, s, end, work, directions + t->inputs * i, slopes);
            for (int q = 0; q < t->outputs; q++)
                if (answers(k, s, end, q)) derivatives[count * q + i] = slopes[q];
        }
    }
}

/* The derivative (m), m and rad, along one direction of the inputs, N and N·m. */
void wb_kriging_along(const wb_table *t, const wb_kriging *k, wb_work *work, const double *wrench,
                      const double *direction, double *slopes) {
    derive(t, k, work, wrench, 1, direction, slopes);
}

/* du/dw (m, n), SI. */
void wb_kriging_derivative(const wb_table *t, const wb_kriging *k, wb_work *work,
                           const double *wrench, double *derivative) {
    double units[WB_MAX * WB_MAX] = {0};
    for (int a = 0; a < t->inputs; a++) units[(t->inputs + 1) * a] = 1.0;
    work->of = NULL;
    derive(t, k, work, wrench, t->inputs, units, derivative);
}
