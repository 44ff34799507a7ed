/* Codes of why an axis does not cover a wrench; surrogate/kernel/reasons.py has the texts. MIT. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

/* One axis' answer to its three loads alone. */
typedef struct {
    wb_composed answer;
    int origin;  /* the axis whose rows answered, or -1 */
    int simplex; /* the simplex of these rows, or -1 */
} axis_report;

/* The axis that answers a moment that acts alone, that of the better cut; -1 without a cut. */
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

/* The reason why an axis does not cover its loads; its code is 0 if it does. `state`: the axis'
   state under the whole wrench. */
static void why_axis(const wb_composition *c, const axis_report *report, int axis, int state,
                     const double *w, wb_reason *reason) {
    int alone = report->answer.states[axis];
    memset(reason, 0, sizeof *reason);
    reason->axis = axis, reason->index = -1;
    if (alone >= WB_OFF_HULL) {
        int none = c->ints[axis].dimension < 0;
        reason->code = none ? WB_REASON_AXIS_NO_ROWS : WB_REASON_AXIS_OFF_HULL;
    } else if (state >= WB_OFF_HULL) {
        reason->code = WB_REASON_MOMENT_ALONE;
        reason->index = 3 + (axis + 1) % 3, reason->value = w[reason->index];
    }
}

/* Add a reason for each axis whose state is the worst one. */
void wb_axes_reasons(const wb_table *t, const wb_group *g, const double *w, wb_result *result) {
    wb_composed all;
    if (!g->has_composition) return;
    wb_compose(&g->composition, t->small, w, &all);
    for (int axis = 0; axis < 3; axis++) {
        wb_reason reason;
        if (all.state == WB_INSIDE || all.states[axis] != all.state) continue;
        axis_report report = report_of(t, g, axis, w);
        why_axis(&g->composition, &report, axis, all.states[axis], w, &reason);
        if (reason.code) *wb_add_reason(result, reason.code) = reason;
    }
}

int wb_axis(const wb_table *t, int group, int axis, const double *inputs, wb_axis_reply *reply) {
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
    memcpy(reply->outputs, report.answer.moved, sizeof reply->outputs);
    reply->coverage = state >= WB_OFF_HULL ? WB_OUTSIDE : WB_COVERED;
    if (reply->coverage != WB_COVERED) why_axis(c, &report, axis, state, w, &reply->reason);
    reply->reasons = reply->reason.code != 0;
    reply->origin = report.origin;
    if (report.simplex < 0) return WB_OK;
    reply->corners = c->ints[report.origin].dimension + 1;
    memcpy(reply->corner, c->simplex[report.simplex].vertex, sizeof reply->corner);
    return WB_OK;
}
