/* The answer of one group of outputs: methods, errors, coverage and rows. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

/* The compliance's answer and its 95 % error. */
static void linear_values(const wb_table *t, const wb_group *g, const double *w, double *outputs,
                          double *error) {
    int n = t->inputs;
    for (int q = 0; q < t->outputs; q++) {
        const double *row = g->fit.matrix + n * q;
        double offset = g->fit.offset ? g->fit.offset[q] : 0.0, size = fabs(offset);
        outputs[q] = offset;
        for (int k = 0; k < n; k++) {
            outputs[q] += w[k] * row[k];
            size += fabs(w[k]) * fabs(row[k]);
        }
        error[q] = g->fit.bar[q] + WB_ROUNDING * size;
    }
}

/* The error of another method: its distance from the exact fit's answer or the kriging's, and the
 * error of that; unknown where there is neither. */
static void widen_by_reference(const wb_table *t, const wb_group *g, wb_work *work,
                               const double *w, wb_result *a) {
    double best[WB_MAX], error[WB_MAX];
    if (g->exact_fit) linear_values(t, g, w, best, error);
    else if (g->has_kriging) wb_kriging_values(t, &g->kriging, work, w, best, error);
    for (int q = 0; q < t->outputs; q++)
        a->error[q] = g->exact_fit || g->has_kriging ? fabs(a->outputs[q] - best[q]) + error[q] : NAN;
}

/* The answer of the axes' triangulations, outside where an axis has no rows around its load. */
static void by_axes(const wb_table *t, const wb_group *g, wb_work *work, const double *w,
                    int method, const wb_composed *c, wb_result *a) {
    a->coverage = c->state >= WB_OFF_HULL ? WB_OUTSIDE : WB_COVERED;
    for (int q = 0; q < 6; q++)
        a->outputs[q] = q > 2 || method == WB_ADDITIVE ? c->moved[q] : c->griddata[q];
    widen_by_reference(t, g, work, w, a);
}

/* A reason for each input beyond the load range. */
static void reason_beyond(const wb_table *t, const double *w, wb_result *a) {
    for (int k = 0; k < t->inputs; k++) {
        double low = t->ends[k], high = t->ends[t->inputs + k];
        if (!(w[k] < low || w[k] > high)) continue;
        wb_reason *reason = wb_add_reason(a, WB_REASON_BEYOND_RANGE);
        reason->index = k, reason->value = w[k], reason->limit = w[k] < low ? low : high;
    }
}

/* The first load that no row varies and that differs from its value in the rows, or -1. */
static int unvaried_load(const wb_table *t, const wb_group *g, const double *w) {
    const wb_kriging *k = &g->kriging;
    for (int a = 0; a < t->inputs; a++) {
        double at = (w[a] - k->centre[a]) * k->rate[a];
        int spanned = k->span[a] <= at && at <= k->span[t->inputs + a];
        if (!g->fit.known[a] && !spanned) return a;
    }
    return -1;
}

/* The answer of the kriging, outside where an input is beyond the load range or no row varies it. */
static void by_kriging(const wb_table *t, const wb_group *g, wb_work *work, const double *w,
                       wb_result *a) {
    wb_kriging_values(t, &g->kriging, work, w, a->outputs, a->error);
    int unknown = unvaried_load(t, g, w);
    a->coverage = unknown >= 0 || wb_is_beyond(t, w) ? WB_OUTSIDE : WB_COVERED;
    if (unknown >= 0) wb_add_reason(a, WB_REASON_UNKNOWN_LOAD)->index = unknown;
    reason_beyond(t, w, a);
}

/* The answer of the compliance, outside where a load acts that no row varies, or beyond the range;
 * its error is not known in the first case, and no less than the fit's own in the others. */
static void by_linear(const wb_table *t, const wb_group *g, wb_work *work, const double *w,
                      wb_result *a) {
    double own[WB_MAX];
    int n = t->inputs, m = t->outputs, unknown = -1;
    for (int k = n - 1; k >= 0; k--)
        if (!g->fit.known[k] && fabs(w[k]) > t->small[k]) unknown = k;
    linear_values(t, g, w, a->outputs, own);
    if (g->exact_fit) memcpy(a->error, own, (size_t)m * sizeof(double));
    else widen_by_reference(t, g, work, w, a);
    for (int q = 0; q < m; q++) {
        double range_size = 0.0;
        for (int k = 0; k < n; k++) range_size += t->scale[k] * fabs(g->fit.matrix[n * q + k]);
        a->solved |= (uint64_t)(g->exact_fit && g->fit.bar[q] <= WB_ROUNDING * range_size) << q;
        a->error[q] = unknown >= 0 ? NAN : wb_larger(a->error[q], own[q]);
    }
    a->coverage = unknown >= 0 || wb_is_beyond(t, w) ? WB_OUTSIDE : WB_COVERED;
    if (unknown >= 0) wb_add_reason(a, WB_REASON_UNKNOWN_LOAD)->index = unknown;
    else reason_beyond(t, w, a);
}

/* Lower the coverage where an error is over what is allowed, or not known. */
static void judge_error(const wb_table *t, const wb_group *g, const wb_options *o, wb_result *a) {
    int over = 0, known = 1, output = -1, m = t->outputs;
    double worst = 1.0;
    for (int q = 0; q < m; q++) {
        double allowed = wb_allowed(g, o, q);
        if (!g->judged[q]) continue;
        over |= !(a->error[q] <= allowed);
        known &= isfinite(a->error[q]) != 0;
        if (a->error[q] > worst * allowed) worst = a->error[q] / allowed, output = q;
    }
    if (a->coverage == WB_COVERED && over) {
        a->coverage = WB_THIN;
        int code = known && output >= 0 ? WB_REASON_OVER_TOLERANCE : WB_REASON_NO_ERROR;
        wb_reason *reason = wb_add_reason(a, code);
        if (code == WB_REASON_OVER_TOLERANCE) {
            reason->index = output, reason->value = a->error[output];
            reason->limit = wb_allowed(g, o, output);
        }
    }
    if (!known)
        for (int q = 0; q < m; q++) a->error[q] = NAN;
}

/* Judge what a method answered; take the row at the wrench where that is not covered. */
static void finish(const wb_table *t, const wb_group *g, const wb_options *o, wb_work *work,
                   const double *w, int with_reasons, wb_result *a) {
    a->row = -1, a->exact = 0;
    if (g->used) judge_error(t, g, o, a);
    if (a->coverage == WB_COVERED) return;
    if (!o->without_rows && wb_answer_by_row(t, g, o, w, a)) {
        int known = 1; /* whether the rows determine the noise of each of its outputs */
        for (int q = 0; q < t->outputs; q++) known &= isnan(a->outputs[q]) || !isnan(a->error[q]);
        a->coverage = known ? WB_COVERED : WB_THIN, a->method = WB_ROW, a->reasons = 0;
        if (!known) wb_add_reason(a, WB_REASON_NO_ERROR);
    } else if (with_reasons && g->used && !a->reasons) {
        wb_axes_reasons(t, g, w, a);
    } else if (with_reasons && g->has_kriging
               && a->reason[0].code == WB_REASON_NO_ERROR) {
        a->reasons = 0;
        wb_kriging_reasons(t, &g->kriging, work, w, a);
        if (!a->reasons) wb_add_reason(a, WB_REASON_NO_ERROR);
    }
}

/* Answer one group of outputs. The axes may have been composed before, by the same calls as
 * `wb_compose`. */
void wb_group_answer(const wb_table *t, const wb_group *g, const wb_options *o, wb_work *work,
                     const double *w, const wb_composed *composed, int with_reasons, wb_result *a) {
    wb_composed c;
    a->method = wb_method_of(g, o), a->reasons = 0, a->solved = 0;
    if (!g->used) {
        int rows = g->rows.count ? WB_REASON_ONLY_BEYOND : WB_REASON_EMPTY;
        wb_add_reason(a, g->has_rows ? WB_REASON_FEW_ROWS : rows);
        for (int q = 0; q < t->outputs; q++) a->outputs[q] = a->error[q] = NAN;
        a->coverage = WB_OUTSIDE, a->method = WB_ESTIMATE;
        finish(t, g, o, work, w, with_reasons, a);
        return;
    }
    int axes = a->method <= WB_ADDITIVE;
    if (!composed && axes) {
        wb_compose(&g->composition, t->small, w, &c);
        composed = &c;
    }
    if (axes) by_axes(t, g, work, w, a->method, composed, a);
    else if (a->method == WB_KRIGING) by_kriging(t, g, work, w, a);
    else by_linear(t, g, work, w, a);
    finish(t, g, o, work, w, with_reasons, a);
}

/* du/dw of a method's interpolant, m and rad over N and N·m. */
void wb_group_slopes(const wb_table *t, const wb_group *g, wb_work *work, const double *w,
                     int method, double *derivative) {
    size_t count = (size_t)t->inputs * (size_t)t->outputs;
    if (!g->used)
        for (size_t k = 0; k < count; k++) derivative[k] = NAN;
    if (!g->used) return;
    if (method == WB_KRIGING) wb_kriging_derivative(t, &g->kriging, work, w, derivative);
    else if (method == WB_LINEAR) memcpy(derivative, g->fit.matrix, count * sizeof(double));
    else wb_compose_derivative(&g->composition, w, method, derivative);
}

/* The same along one direction of the inputs, N and N·m: (m), m and rad. */
void wb_group_along(const wb_table *t, const wb_group *g, wb_work *work, const double *w, int method,
                    const double *direction, double *slopes) {
    double derivative[WB_MAX * WB_MAX];
    if (g->used && method == WB_KRIGING) {
        wb_kriging_along(t, &g->kriging, work, w, direction, slopes);
        return;
    }
    wb_group_slopes(t, g, work, w, method, derivative);
    wb_times(derivative, direction, t->outputs, t->inputs, slopes);
}
