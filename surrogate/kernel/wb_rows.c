/* What a request asks of a group of outputs, and the row at or near a wrench. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

wb_reason *wb_add_reason(wb_result *a, int code) {
    wb_reason *reason = &a->reason[a->reasons < WB_MAX_REASONS ? a->reasons++ : WB_MAX_REASONS - 1];
    memset(reason, 0, sizeof *reason);
    reason->code = code, reason->axis = reason->index = -1;
    return reason;
}

/* The method that answers: without a kriging the default does in its place. */
int wb_method_of(const wb_group *g, const wb_options *o) {
    int method = o && o->method != WB_DEFAULT ? o->method : g->method;
    return method == WB_KRIGING && !g->has_kriging ? g->method : method;
}

/* The largest interpolation error of a covered answer: the request's tolerance, else the
 * component's or the default one. Outputs of other groups do not count. */
double wb_allowed(const wb_group *g, const wb_options *o, int q) {
    if (!g->judged[q]) return INFINITY;
    return o && o->tolerance && !isnan(o->tolerance[q]) ? o->tolerance[q] : g->allowed[q];
}

/* Whether a wrench is beyond the load range, with the ends that the file brings. */
int wb_is_beyond(const wb_table *t, const double *w) {
    for (int k = 0; k < t->inputs; k++)
        if (w[k] < t->ends[k] || w[k] > t->ends[t->inputs + k]) return 1;
    return 0;
}

/* Whether a table cut to a scene lacks a wrench: 1 beyond the range of a load that varies, 2 by a
 * load that the scene holds at another value. */
int wb_leaves_scene(const wb_table *t, const double *w) {
    int leaves = 0;
    if (t->scene_ends)
        for (int k = 0; k < t->inputs; k++)
            if (w[k] < t->scene_ends[k] || w[k] > t->scene_ends[t->inputs + k])
                leaves = leaves > 1 || !t->scene_varying[k] ? 2 : 1;
    return leaves;
}

/* The nearest row within WB_NEAR in each load, of equally near ones the first, or -1. */
int64_t wb_find_row(const wb_table *t, const wb_group *g, const double *w) {
    const wb_rows *r = &g->rows;
    double key = 0, closest = WB_NEAR, window = WB_NEAR * (1 + 1e-6);
    int n = t->inputs;
    if (!r->count || wb_leaves_scene(t, w)) return -1;
    for (int k = 0; k < n; k++) key += w[k] * r->rates[k];
    int64_t bucket = wb_bucket(key - window, r->bucket, r->buckets), row = -1;
    int64_t low = r->start[bucket], high = r->start[bucket + 1];
    while (low < high) {
        int64_t middle = low + (high - low) / 2;
        if (r->key[middle] < key - window) low = middle + 1;
        else high = middle;
    }
    for (; low < r->count && r->key[low] <= key + window; low++) {
        double apart = 0;
        for (int k = 0; k < n; k++)
            apart = wb_larger(fabs(r->wrench[n * low + k] - w[k]) / t->scale[k], apart);
        if (!(apart <= closest)) continue;
        if (apart == closest && row >= 0 && r->number[low] > r->number[row]) continue;
        closest = apart, row = low;
    }
    return row;
}

/* The largest of an output's kind, translations or rotations of one interface. */
static double largest_of_kind(const wb_table *t, const double *moved, int q) {
    int first = t->outputs % 3 ? q : q / 3 * 3, count = t->outputs % 3 ? 1 : 3;
    double largest = NAN;
    for (int k = first; k < first + count; k++) largest = fmax(fabs(moved[k]), largest);
    return largest;
}

/* How much each output may move without a tangent, over half the load range. */
static double slopes_without_tangent(const wb_table *t, const wb_group *g, int64_t row,
                                     double *slope) {
    double far = 0, steep = 0;
    const double *moved = g->rows.moved + t->outputs * row;
    for (int k = 0; k < t->inputs; k++)
        far = wb_larger(fabs(g->rows.wrench[t->inputs * row + k] / t->scale[k]), far);
    for (int q = 0; q < t->outputs; q++) {
        slope[q] = g->rows.steepest[q];
        if (far > 0) slope[q] = fmax(WB_STEEPER / far * largest_of_kind(t, moved, q), slope[q]);
        steep = wb_larger(slope[q], steep);
    }
    return steep;
}

/* Take what the row at or near a wrench says, unless it is too far off. */
int wb_answer_by_row(const wb_table *t, const wb_group *g, const wb_options *o, const double *w,
                     wb_result *a) {
    int n = t->inputs, m = t->outputs;
    int64_t row = wb_find_row(t, g, w);
    if (row < 0) return 0;
    const double *wrench = g->rows.wrench + n * row, *moved = g->rows.moved + m * row;
    int64_t index = g->rows.tangent_of[row];
    const double *tangent = index < 0 ? NULL : g->rows.tangent + n * m * index;
    double step[WB_MAX], slope[WB_MAX], outputs[WB_MAX], error[WB_MAX], distance = 0;
    a->exact = 1;
    for (int k = 0; k < n; k++) {
        step[k] = w[k] - wrench[k];
        a->exact &= step[k] == 0;
        distance = wb_larger(fabs(step[k] / t->scale[k]), distance);
    }
    if (wb_is_beyond(t, w) != wb_is_beyond(t, wrench)) return 0;
    double steep = slopes_without_tangent(t, g, row, slope);
    for (int q = 0; q < m; q++) {
        double more = 0, growth = steep > 0 ? slope[q] * distance : NAN;
        for (int k = 0; tangent && k < n; k++) more += tangent[n * q + k] * step[k];
        if (tangent && isfinite(more)) growth = fabs(more);
        else more = 0;
        if (!(distance > 0) || isnan(moved[q])) more = growth = 0;
        if (!(growth <= wb_allowed(g, o, q))) return 0;
        outputs[q] = moved[q] + more;
        error[q] = g->rows.bar[m * row + q] + growth;
    }
    memcpy(a->outputs, outputs, (size_t)m * sizeof(double));
    memcpy(a->error, error, (size_t)m * sizeof(double));
    a->row = row, a->solved = 0;
    for (int q = 0; q < m; q++)
        a->solved |= (uint64_t)(g->rows.bar[m * row + q] == 0) << q;
    return 1;
}
