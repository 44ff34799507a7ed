/* Three axes to one answer. MIT license.
 *
 * u = u(0) + sum over axes of (axis - u(0)) - sum over moments of (that moment alone - u(0)) for all
 * six outputs; with the method `griddata` each translation is that of its axis alone. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

/* The answer to one moment alone: all six outputs. */
typedef struct {
    double outputs[6], slopes[6];
    int state;
} alone_part;

/* The stretch that holds a scaled moment; beyond an end the stretch at this end. */
static int stretch_of(const wb_cut *cut, double along) {
    int64_t bucket = wb_bucket(along, cut->bucket, cut->buckets);
    int low = cut->start[bucket], high = cut->start[bucket + 1];
    while (low < high) { /* bisection for the first station above the moment */
        int middle = low + (high - low) / 2;
        if (cut->stations[middle] <= along) low = middle + 1;
        else high = middle;
    }
    return low < 1 ? 0 : low > cut->stretches ? cut->stretches - 1 : low - 1;
}

static int state_at(const wb_cut *cut, double along, int stretch) {
    if (along < cut->stations[0] - WB_ZERO_LOAD) return WB_OFF_HULL;
    if (along > cut->stations[cut->stretches] + WB_ZERO_LOAD) return WB_OFF_HULL;
    return cut->state[stretch];
}

int wb_cut_state(const wb_cut *cut, double moment) {
    double along = moment / cut->scale;
    return cut->stretches ? state_at(cut, along, stretch_of(cut, along)) : WB_OFF_HULL;
}

/* The answer in a stretch of a cut. */
static void read_cut(const wb_cut *cut, double along, int stretch, int with_slopes,
                     alone_part *out) {
    const double *o = cut->outputs + 12 * (int64_t)stretch;
    double y = along - cut->stations[stretch];
    for (int q = 0; q < 6; q++) out->outputs[q] = o[q] + y * o[6 + q];
    if (with_slopes)
        for (int q = 0; q < 6; q++) out->slopes[q] = o[6 + q] / cut->scale;
}

/* The answer to a moment that has no rows, by the fitted compliance. */
static void read_fit(const wb_composition *c, int load, double amount, alone_part *out) {
    for (int q = 0; q < 6; q++) {
        double slope = c->fit->matrix[6 * q + load];
        out->outputs[q] = c->zero_load[q] + amount * slope;
        out->slopes[q] = slope;
    }
}

/* The answer to one moment alone, by the axis that has the moment first, or by the other axis. */
static void read_alone(const wb_composition *c, int moment, double amount, int with_slopes,
                       alone_part *out) {
    const wb_cut *best = NULL;
    double along = 0.0;
    int best_stretch = 0;
    out->state = WB_NO_ROWS;
    for (int k = 0; k < 2 && out->state >= WB_OFF_HULL; k++) {
        const wb_cut *cut = &c->cuts[moment][k];
        if (!cut->present) continue;
        if (!cut->stretches) { /* the axis has rows, but none with this moment alone */
            if (WB_OFF_HULL < out->state) out->state = WB_OFF_HULL;
            continue;
        }
        double scaled = amount / cut->scale;
        int stretch = stretch_of(cut, scaled), state = state_at(cut, scaled, stretch);
        if (state >= out->state) continue;
        out->state = state;
        best = cut, along = scaled, best_stretch = stretch;
    }
    if (!best) read_fit(c, moment + 3, amount, out);
    else read_cut(best, along, best_stretch, with_slopes, out);
}

static int worse(int a, int b) { return a > b ? a : b; }

/* Add `times` of an answer. */
static void add_part(const double outputs[6], double times, wb_composed *out) {
    for (int q = 0; q < 6; q++) out->moved[q] += times * outputs[q];
    out->times += times;
}

void wb_compose_start(const wb_composition *c, wb_composed *out) {
    memset(out, 0, sizeof *out);
    memcpy(out->griddata, c->zero_load, sizeof out->griddata);
}

/* Add the answer at zero load, so that the factors of all parts sum to one. */
static void add_zero_load(const wb_composition *c, wb_composed *out) {
    double remaining = 1.0 - out->times;
    if (remaining == 0.0) return;
    for (int q = 0; q < 6; q++) out->moved[q] += remaining * c->zero_load[q];
}

/* Whether the axis' triangulation is needed: its force, or both of its moments, are not zero. */
int wb_needs_axis(const double small[6], const double wrench[6], int axis) {
    int first = 3 + (axis + 1) % 3, second = 3 + (axis + 2) % 3;
    if (fabs(wrench[axis]) > small[axis]) return 1;
    return fabs(wrench[first]) > small[first] && fabs(wrench[second]) > small[second];
}

void wb_add_axis(const wb_part *part, int axis, wb_composed *out) {
    out->griddata[axis] = part->outputs[axis];
    add_part(part->outputs, 1.0, out);
    out->states[axis] = part->state;
}

/* Add the answers to single moments and to zero load, after those of the axes. */
void wb_add_moments(const wb_composition *c, const double small[6], const double wrench[6],
                    wb_composed *out) {
    for (int m = 0; m < 3; m++) {
        alone_part alone;
        double times = -1.0; /* plus one for each axis that has this moment as its only load */
        if (!(fabs(wrench[3 + m]) > small[3 + m])) continue;
        read_alone(c, m, wrench[3 + m], 0, &alone);
        int base = (m + 2) % 3; /* the axis that has the moment first */
        for (int k = 0; k < 2; k++) {
            int axis = (m + 2 - k) % 3;
            int other = 3 + (axis + 1 + !k) % 3; /* the axis' other moment */
            if (fabs(wrench[axis]) > small[axis] || fabs(wrench[other]) > small[other]) continue;
            times += 1.0;
            out->griddata[axis] = alone.outputs[axis];
            out->states[axis] = worse(out->states[axis], alone.state);
        }
        if (times == 0.0) continue;
        add_part(alone.outputs, times, out);
        out->states[base] = worse(out->states[base], alone.state);
    }
    add_zero_load(c, out);
    out->state = worse(worse(out->states[0], out->states[1]), out->states[2]);
}

void wb_compose(const wb_composition *c, const double small[6], const double wrench[6],
                wb_composed *out) {
    wb_compose_start(c, out);
    for (int axis = 0; axis < 3; axis++) {
        wb_part part;
        if (!wb_needs_axis(small, wrench, axis)) continue;
        wb_axis_part(c, axis, wrench, 0, &part);
        wb_add_axis(&part, axis, out);
    }
    wb_add_moments(c, small, wrench, out);
}

/* du/dw of the sum over all axes and moments, so that a load of zero has its slope too. */
void wb_compose_derivative(const wb_composition *c, const double wrench[6], int method,
                           double derivative[36]) {
    int additive = method == WB_ADDITIVE;
    memset(derivative, 0, 36 * sizeof(double));
    for (int axis = 0; axis < 3; axis++) {
        int inputs[3] = {axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3};
        wb_part part;
        wb_axis_part(c, axis, wrench, 1, &part);
        for (int q = 0; q < 6; q++) {
            if (q < 3 && q != axis && !additive) continue;
            for (int i = 0; i < 3; i++) derivative[6 * q + inputs[i]] += part.slopes[q][i];
        }
    }
    for (int m = 0; m < 3; m++) {
        alone_part alone;
        read_alone(c, m, wrench[3 + m], 1, &alone);
        for (int q = additive ? 0 : 3; q < 6; q++)
            derivative[6 * q + 3 + m] -= alone.slopes[q];
    }
}
