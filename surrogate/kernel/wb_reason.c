/* Why an axis does not cover a wrench, as codes; surrogate/kernel/reasons.py has the words. MIT. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

/* One axis' answer to its three loads alone, and where its rows were read. */
typedef struct {
    wb_composed answer;
    int origin, simplex; /* the axis whose rows answered, or -1 */
} axis_report;

static double volume_part(const wb_composition *c, int axis, int simplex) {
    static const double CORNERS[] = {1, 1, 2, 6}; /* of a box by simplices: d factorial */
    const double *m = c->simplex[simplex].map;
    int d = c->ints[axis].dimension;
    double over = m[0];
    if (d == 0) return 0.0;
    if (d == 2) over = m[0] * m[4] - m[1] * m[3];
    if (d == 3)
        over = m[0] * (m[4] * m[8] - m[5] * m[7]) - m[1] * (m[3] * m[8] - m[5] * m[6])
               + m[2] * (m[3] * m[7] - m[4] * m[6]);
    return fabs(1.0 / over) / CORNERS[d] / (double)(1 << d);
}

/* The axis and input of a moment that acts alone: that of the better cut. */
static int axis_of_moment(const wb_composition *c, int moment, double amount) {
    int axis = -1, best = 0;
    for (int k = 0; k < 2; k++) {
        if (!c->cuts[moment][k].present) continue;
        int state = wb_cut_state(&c->cuts[moment][k], amount);
        if (axis < 0 || state < best) best = state, axis = (moment + (k ? 1 : 2)) % 3;
    }
    return axis;
}

static axis_report report_of(const wb_table *t, const wb_group *g, int axis, const double *w) {
    const wb_composition *c = &g->composition;
    double loads[6] = {0};
    int loaded = 0, last = -1;
    axis_report report;
    for (int k = 0; k < 6; k++) {
        if (k != axis && k != 3 + (axis + 1) % 3 && k != 3 + (axis + 2) % 3) continue;
        loads[k] = w[k];
        if (fabs(w[k]) > t->small[k]) loaded++, last = k;
    }
    wb_compose(c, t->small, loads, &report.answer);
    report.origin = c->ints[axis].dimension < 0 ? -1 : axis, report.simplex = -1;
    if (loaded == 1 && last >= 3) report.origin = axis_of_moment(c, last - 3, loads[last]);
    if (report.origin >= 0 && loaded) {
        wb_part part;
        wb_axis_part(c, report.origin, loads, 0, &part);
        report.simplex = part.simplex;
    }
    return report;
}

static void why_weak(const wb_composition *c, int axis, int simplex, wb_reason *reason) {
    int points = c->point_first[axis + 1] - c->point_first[axis];
    double part = volume_part(c, axis, simplex), max_part = c->largest[c->ints[axis].dimension];
    reason->axis = axis;
    if (c->state[simplex] == WB_SOUND) {
        reason->code = WB_REASON_AXIS_TOGETHER;
        reason->value = c->together[axis], reason->limit = c->left_out[3];
    } else if (points < c->fewest[axis]) {
        reason->code = WB_REASON_AXIS_FEW_ROWS;
        reason->value = points, reason->limit = c->fewest[axis];
    } else if (c->state[simplex] != WB_DEGENERATE && !(part > max_part)) {
        reason->code = WB_REASON_AXIS_ERRORS_UNKNOWN;
        reason->value = c->left_out[axis], reason->limit = c->left_out[3];
    } else if (c->state[simplex] == WB_DEGENERATE) {
        reason->code = WB_REASON_AXIS_DEGENERATE;
    } else {
        reason->code = WB_REASON_AXIS_FAR_APART;
        reason->value = part, reason->limit = max_part;
    }
}

/* `why_axis`; the reason's code is 0 if the axis covers its part. `state` is of the whole wrench. */
static void why_axis(const wb_composition *c, const axis_report *report, int axis, int state,
                     const double *w, wb_reason *reason) {
    int alone = report->answer.states[axis];
    memset(reason, 0, sizeof *reason);
    reason->axis = axis, reason->index = -1;
    if (alone >= WB_OFF_HULL) {
        int none = c->ints[axis].dimension < 0;
        reason->code = none ? WB_REASON_AXIS_NO_ROWS : WB_REASON_AXIS_OFF_HULL;
    } else if (report->simplex >= 0 && alone > WB_SOUND) {
        why_weak(c, report->origin, report->simplex, reason);
    } else if (state >= WB_OFF_HULL) {
        reason->code = WB_REASON_MOMENT_ALONE;
        reason->index = 3 + (axis + 1) % 3, reason->value = w[reason->index];
    }
}

/* Add a reason of each axis that is as badly off as the worst. */
void wb_axes_reasons(const wb_table *t, const wb_group *g, const double *w, wb_result *a) {
    wb_composed all;
    if (!g->has_composition) return;
    wb_compose(&g->composition, t->small, w, &all);
    for (int axis = 0; axis < 3; axis++) {
        wb_reason reason;
        if (all.state == WB_SOUND || all.states[axis] != all.state) continue;
        axis_report report = report_of(t, g, axis, w);
        why_axis(&g->composition, &report, axis, all.states[axis], w, &reason);
        if (reason.code) *wb_add_reason(a, reason.code) = reason;
    }
}

static void judge_axis(const wb_options *o, wb_axis_reply *reply, int axis) {
    double worst = 1.0;
    if (!o || !o->tolerance || reply->coverage != WB_COVERED) return;
    for (int q = 0; q < 6; q++) {
        double tolerance = o->tolerance[q];
        if ((q < 3 && q != axis) || isnan(tolerance) || !(reply->error[q] > worst * tolerance)) continue;
        worst = reply->error[q] / tolerance;
        reply->coverage = WB_THIN, reply->reasons = 1;
        reply->reason.code = WB_REASON_OVER_TOLERANCE;
        reply->reason.axis = axis, reply->reason.index = q;
        reply->reason.value = reply->error[q], reply->reason.limit = tolerance;
    }
}

int wb_axis(const wb_table *t, const wb_options *o, int group, int axis, const double *inputs,
            wb_axis_reply *reply) {
    double w[WB_MAX];
    wb_composed all;
    memset(reply, 0, sizeof *reply);
    if (group < 0 || group >= t->groups || axis < 0 || axis > 2) return WB_NO_METHOD;
    const wb_group *g = &t->group[group];
    if (!g->has_composition) return WB_NO_METHOD;
    for (int k = 0; k < t->inputs; k++) {
        if (!isfinite(inputs[k])) return WB_NOT_FINITE;
        w[k] = t->locked[k] ? 0.0 : inputs[k] + 0.0;
    }
    const wb_composition *c = &g->composition;
    wb_compose(c, t->small, w, &all);
    axis_report report = report_of(t, g, axis, w);
    int state = all.states[axis];
    for (int q = 0; q < 6; q++) {
        reply->outputs[q] = report.answer.moved[q];
        reply->error[q] = sqrt(report.answer.squares[q]);
    }
    reply->coverage = state >= WB_OFF_HULL ? WB_OUTSIDE : state > WB_SOUND ? WB_THIN : WB_COVERED;
    if (reply->coverage != WB_COVERED) why_axis(c, &report, axis, state, w, &reply->reason);
    reply->reasons = reply->reason.code != 0;
    judge_axis(o, reply, axis);
    reply->origin = report.origin;
    if (report.simplex < 0) return WB_OK;
    reply->corners = c->ints[report.origin].dimension + 1;
    memcpy(reply->corner, c->simplex[report.simplex].vertex, sizeof reply->corner);
    return WB_OK;
}
