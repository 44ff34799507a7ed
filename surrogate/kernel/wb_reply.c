/* From the answers of groups of outputs to a reply, with the solver's error. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

static double larger(double a, double b) { return a > b ? a : b; }

static const wb_options DEFAULTS = {WB_DEFAULT, NULL, 0};

/* A reply without outputs, at the inputs that act. */
static void clear_reply(const wb_table *t, const double *inputs, wb_reply *reply) {
    reply->coverage = WB_COVERED, reply->within = -1, reply->method = WB_ESTIMATE;
    reply->exact = reply->reasons = reply->group = 0;
    reply->row = reply->index = -1, reply->missing = 0, reply->solved = 0;
    reply->unknown = reply->unused = 0;
    for (int k = 0; k < t->inputs; k++) /* no negative zeros; no loads on locked freedoms */
        reply->inputs[k] = t->locked[k] ? 0.0 : inputs[k] + 0.0;
    for (int q = 0; q < t->outputs; q++) {
        reply->outputs[q] = reply->interpolation[q] = NAN;
        reply->missing |= (uint64_t)1 << q;
    }
}

/* Whether the text of a reason depends on the rows of its group. */
static int is_of_group(int code) {
    return code == WB_REASON_AXIS_OFF_HULL || code == WB_REASON_BEYOND_SPAN;
}

/* Whether the reply has a reason already. */
static int has_reason(const wb_reply *reply, const wb_reason *reason, int group) {
    for (int i = 0; i < reply->reasons; i++) {
        const wb_reason *known = &reply->reason[i];
        if (known->group != group && is_of_group(reason->code)) continue;
        if (known->code == reason->code && known->axis == reason->axis && known->index == reason->index
            && known->value == reason->value && known->limit == reason->limit)
            return 1;
    }
    return 0;
}

/* Copy a group's outputs to the reply. Coverage, method and row are those of the worst group. */
static void take_group(const wb_table *t, const wb_group *g, const wb_result *result, wb_work *work,
                       wb_reply *reply, int *worst) {
    const int32_t *held = g->held ? g->held : g->outputs;
    int number = (int)(g - t->group), read = 0;
    for (int q = 0; q < t->outputs; q++) {
        if (held[q]) work->moved[q] = result->outputs[q];
        if (!g->outputs[q]) continue;
        read = 1;
        reply->outputs[q] = result->outputs[q], reply->interpolation[q] = result->error[q];
        reply->missing &= ~((uint64_t)1 << q);
        reply->solved |= result->solved & (uint64_t)1 << q;
    }
    if (!read) return;
    for (int i = 0; i < result->reasons; i++) {
        if (reply->reasons == WB_MAX_REASONS || has_reason(reply, &result->reason[i], number))
            continue;
        reply->reason[reply->reasons] = result->reason[i];
        reply->reason[reply->reasons++].group = number;
    }
    int rank = 2 * result->coverage + (result->method != WB_ROW);
    if (rank <= *worst) return;
    *worst = rank;
    reply->coverage = result->coverage, reply->method = result->method, reply->group = number;
    reply->index = result->method == WB_ROW ? result->row : -1;
    reply->row = reply->index < 0 ? -1 : g->rows.seq[reply->index];
    reply->exact = result->exact;
}

/* du/dw of a reply: the interpolants', or the tangents of the rows that answer. */
void wb_reply_derivative(const wb_table *t, const wb_options *o, wb_work *work,
                         const wb_reply *reply, double *derivative) {
    int n = t->inputs, m = t->outputs;
    double group_slopes[WB_MAX * WB_MAX];
    for (int k = 0; k < n * m; k++) derivative[k] = NAN;
    for (int i = 0; i < t->groups; i++) {
        const wb_group *g = &t->group[i];
        const double *slopes = group_slopes;
        if (reply->method == WB_ROW) {
            int64_t row = wb_find_row(t, g, reply->inputs);
            int64_t index = row < 0 ? -1 : g->rows.tangent_of[row];
            if (index < 0) continue;
            slopes = g->rows.tangent + (int64_t)n * m * index;
        } else {
            wb_group_slopes(t, g, work, reply->inputs, wb_method_of(g, o), group_slopes);
        }
        for (int q = 0; q < m; q++)
            if (g->outputs[q]) memcpy(derivative + n * q, slopes + n * q, (size_t)n * sizeof(double));
    }
    for (int k = 0; k < n; k++) {
        int absent = t->scene_slopes && !t->scene_slopes[k]; /* a scene's table has not all axes */
        for (int q = 0; q < m; q++) {
            double *slope = derivative + n * q + k;
            if (absent) *slope = NAN;
            /* A guide carries this load: no displacement depends on it. */
            if (t->locked[k] && !isnan(*slope)) *slope = 0.0;
        }
    }
}

/* The mesh's error |T D u|: T is the answer's tangent, u its displacement, D the stiffness that the
 * mesh adds. NaN where no tangent is known. */
static void mesh_error(const wb_table *t, const wb_options *o, wb_work *work, const wb_reply *reply,
                       double *error) {
    int n = t->inputs, m = t->outputs;
    double pushed[WB_MAX], slopes[WB_MAX];
    wb_times(t->solver.stiffness, work->moved, n, m, pushed);
    for (int k = 0; k < n; k++)
        if (t->locked[k]) pushed[k] = 0.0;
    for (int q = 0; q < m; q++) error[q] = NAN;
    for (int i = 0; i < t->groups; i++) {
        const wb_group *g = &t->group[i];
        int64_t row = reply->method == WB_ROW ? wb_find_row(t, g, reply->inputs) : -1;
        int64_t index = row < 0 ? -1 : g->rows.tangent_of[row];
        if (index >= 0) wb_times(g->rows.tangent + (int64_t)n * m * index, pushed, m, n, slopes);
        else wb_group_along(t, g, work, reply->inputs, wb_method_of(g, o), pushed, slopes);
        for (int q = 0; q < m; q++)
            if (g->outputs[q]) error[q] = fabs(slopes[q]);
    }
}

/* No error of a solver: measured rows, or rows whose solver's error is not known. */
static void without_solver_error(const wb_table *t, wb_reply *reply) {
    const wb_solver *s = &t->solver;
    for (int q = 0; q < t->outputs; q++) {
        reply->error[q] = reply->interpolation[q];
        reply->discretisation[q] = s->mesh_known ? 0.0 : NAN;
        reply->linearity[q] = !s->linear || s->linearity_known ? 0.0 : NAN;
    }
}

/* The error of a linear analysis: half the second derivatives times the loads twice, and a remainder
 * with the cube of the largest load; without second derivatives with its square. A remainder that
 * saturates grows with the load in the end. */
static double linearity_error(const wb_table *t, int q, const double *acting, double largest) {
    const wb_solver *s = &t->solver;
    int n = t->inputs;
    double b = s->saturation ? s->saturation[q] : 0, sum = 0;
    double power = s->second ? largest * largest : largest;
    double remainder = s->linearity[q] * (largest * power) * ((1 + b) / (1 + b * power));
    if (!s->second) return remainder;
    for (int k = 0; k < n; k++)
        for (int l = 0; l < n; l++) sum += s->second[(q * n + k) * n + l] * acting[k] * acting[l];
    return 0.5 * fabs(sum) + remainder;
}

/* Add the solver's errors: of its mesh by the answer's tangent, and no less than by the compliance at
 * small loads; of a linear analysis. */
static void add_solver_error(const wb_table *t, const wb_options *o, wb_work *work, wb_reply *reply) {
    const wb_solver *s = &t->solver;
    double largest = 0, by_tangent[WB_MAX], by_loads[WB_MAX], acting[WB_MAX], size[WB_MAX];
    for (int k = 0; k < t->inputs; k++) {
        acting[k] = reply->inputs[k] - (s->zero ? s->zero[k] : 0.0);
        size[k] = fabs(acting[k]);
        largest = larger(size[k] * s->one_over[k], largest);
    }
    wb_times(s->mesh, size, t->outputs, t->inputs, by_loads);
    if (s->by_tangent) mesh_error(t, o, work, reply, by_tangent);
    for (int q = 0; q < t->outputs; q++) {
        double mesh = s->by_tangent && by_tangent[q] > by_loads[q] ? by_tangent[q] : by_loads[q];
        double linearity = linearity_error(t, q, acting, largest);
        reply->error[q] = reply->interpolation[q] + mesh + linearity;
        reply->discretisation[q] = s->mesh_known ? mesh : NAN;
        reply->linearity[q] = !s->linear || s->linearity_known ? linearity : NAN;
    }
}

/* Whether the total error is within the tolerance; outputs without a value are left out. */
static int is_within(const wb_table *t, const wb_options *o, const wb_reply *reply) {
    int known = -1, unjudged = 0;
    if (!t->solver.whole) return -1; /* a part of the error is not known */
    for (int q = 0; q < t->outputs; q++) {
        double allowed = o->tolerance && !isnan(o->tolerance[q]) ? o->tolerance[q] : t->tolerance[q];
        if (isnan(allowed)) return -1; /* no tolerance */
        if (isnan(reply->error[q])) {
            unjudged |= !isnan(reply->outputs[q]); /* an output without an error: a dead channel */
            continue;
        }
        if (!(reply->error[q] <= allowed)) return 0;
        known = 1;
    }
    return unjudged ? -1 : known;
}

/* Whether a displacement exceeds the limits of tables: 20 degrees, 10 m. */
static int beyond_limits(const wb_table *t, const double *outputs) {
    for (int q = 0; q < t->outputs; q++)
        if (fabs(outputs[q]) > t->limit[q]) return 1;
    for (int i = 0; i < t->vectors; i++) {
        double sum = 0;
        for (int q = t->vector_first[i]; q < t->vector_first[i] + 3; q++)
            if (!isnan(outputs[q])) sum += outputs[q] * outputs[q];
        if (sqrt(sum) > t->vector_limit[i]) return 1;
    }
    return 0;
}

/* A table cut to a scene: beyond the scene's loads it has estimates without an error, or none. */
static void judge_scene(const wb_table *t, wb_reply *reply) {
    int leaves = wb_leaves_scene(t, reply->inputs), n = t->inputs, known = 0;
    for (int q = 0; q < t->outputs; q++) known |= !(reply->missing >> q & 1);
    if (!known) reply->coverage = WB_OUTSIDE; /* no row holds an output that the scene reads */
    if (!leaves) return;
    reply->coverage = WB_OUTSIDE, reply->reasons = 0;
    for (int q = 0; q < t->outputs; q++) {
        reply->interpolation[q] = NAN;
        if (leaves > 1) reply->outputs[q] = NAN;
    }
    for (int k = 0; k < n && reply->reasons < WB_MAX_REASONS; k++) {
        double load = reply->inputs[k], low = t->scene_ends[k], high = t->scene_ends[n + k];
        if (!(load < low || load > high)) continue;
        wb_reason *reason = &reply->reason[reply->reasons++];
        memset(reason, 0, sizeof *reason);
        reason->code = WB_REASON_NOT_IN_SCENE, reason->axis = -1, reason->index = k;
        reason->value = load, reason->limit = load < low ? low : high;
    }
}

/* Add the errors of solver and rig; remove an estimate beyond the limits of tables. */
void wb_conclude(const wb_table *t, const wb_options *o, wb_work *work, wb_reply *reply) {
    if (t->scene_ends) judge_scene(t, reply);
    if (t->solver.none) without_solver_error(t, reply);
    else add_solver_error(t, o, work, reply);
    for (int q = 0; q < t->outputs; q++) {
        reply->measurement[q] = t->rig_error ? t->rig_error[q] : 0.0;
        reply->error[q] += reply->measurement[q];
    }
    if (!t->solver.whole) /* the solver's error is all there is */
        for (int q = 0; q < t->outputs; q++)
            if (reply->solved >> q & 1) reply->error[q] = NAN;
    if (reply->coverage != WB_COVERED && beyond_limits(t, reply->outputs)) {
        for (int q = 0; q < t->outputs; q++) {
            reply->outputs[q] = reply->error[q] = reply->interpolation[q] = NAN;
            reply->discretisation[q] = reply->linearity[q] = reply->measurement[q] = NAN;
        }
        int index = reply->reasons < WB_MAX_REASONS ? reply->reasons++ : WB_MAX_REASONS - 1;
        memset(&reply->reason[index], 0, sizeof reply->reason[index]);
        reply->reason[index].code = WB_REASON_BEYOND_LIMITS;
        reply->reason[index].axis = reply->reason[index].index = -1;
    }
}

/* Whether all inputs are finite and each group has the method. */
int wb_check(const wb_table *t, const wb_options *o, const double *inputs) {
    if (o->method < WB_DEFAULT || o->method >= WB_METHODS) return WB_NO_METHOD;
    for (int k = 0; k < t->inputs; k++)
        if (!isfinite(inputs[k])) return WB_NOT_FINITE;
    for (int i = 0; i < t->groups; i++) {
        const wb_group *g = &t->group[i];
        if (g->used && wb_method_of(g, o) <= WB_ADDITIVE && !g->has_composition) return WB_NO_METHOD;
    }
    return WB_OK;
}

static void count_unknown(const wb_table *t, wb_reply *reply) {
    for (int q = 0; q < t->outputs; q++) {
        reply->unknown += (isnan(reply->outputs[q]) != 0) + (isnan(reply->error[q]) != 0);
        reply->unknown += (isnan(reply->interpolation[q]) != 0) + (isnan(reply->linearity[q]) != 0);
        reply->unknown += (isnan(reply->discretisation[q]) != 0) + (isnan(reply->measurement[q]) != 0);
    }
}

/* The answers of the groups of outputs to one wrench.
 * `composed`: the axes of the only group, where a batch has composed them; else NULL. */
void wb_reply_of(const wb_table *t, const wb_options *o, wb_work *work, const double *inputs,
                 const wb_composed *composed, int with_reasons, wb_reply *reply) {
    int worst = -1;
    clear_reply(t, inputs, reply);
    work->of = NULL;
    for (int q = 0; q < t->outputs; q++) work->moved[q] = NAN;
    for (int i = 0; i < t->groups; i++) {
        wb_result result;
        wb_group_answer(t, &t->group[i], o, work, reply->inputs, composed, with_reasons, &result);
        take_group(t, &t->group[i], &result, work, reply, &worst);
    }
}

int wb_answer(const wb_table *t, const wb_options *options, const double *inputs, wb_reply *reply,
              void *scratch) {
    const wb_options *o = options ? options : &DEFAULTS;
    wb_work work = wb_work_of(t, scratch);
    int wrong = wb_check(t, o, inputs);
    if (wrong) return wrong;
    wb_reply_of(t, o, &work, inputs, NULL, 1, reply);
    wb_conclude(t, o, &work, reply);
    reply->within = is_within(t, o, reply);
    count_unknown(t, reply);
    return WB_OK;
}

/* du/dw of the answer. Only a row near the wrench can answer in the method's place: without one
 * in each group the method's slopes are the answer's. */
void wb_answer_slopes(const wb_table *t, const wb_options *o, wb_work *work, const double *inputs,
                      double *derivative) {
    wb_reply reply;
    int near = !o->without_rows;
    clear_reply(t, inputs, &reply);
    for (int i = 0; near && i < t->groups; i++)
        near = wb_find_row(t, &t->group[i], reply.inputs) >= 0;
    if (near) wb_reply_of(t, o, work, inputs, NULL, 0, &reply);
    wb_reply_derivative(t, o, work, &reply, derivative);
}

int wb_derivative(const wb_table *t, const wb_options *options, const double *inputs, double *du_dw,
                  void *scratch) {
    const wb_options *o = options ? options : &DEFAULTS;
    wb_work work = wb_work_of(t, scratch);
    int wrong = wb_check(t, o, inputs);
    if (!wrong) wb_answer_slopes(t, o, &work, inputs, du_dw);
    return wrong;
}

#ifndef WB_SOURCES
#define WB_SOURCES "unknown"
#endif
const char *wb_sources(void) { return WB_SOURCES; }
