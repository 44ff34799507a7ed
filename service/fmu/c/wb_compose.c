/* Three axes to one answer: surrogate/composition/composition.py and pure_moment.py. MIT. */
#include "wb_table.h"

#include <math.h>
#include <string.h>

static const double ON_HULL = 1e-9; /* of the range: that far beyond the last station is on it */

/* The answer to one moment alone: all six outputs. */
typedef struct {
    double outputs[6], bends[6], rest[6], slopes[6], bend_slopes[6];
    int state;
} alone_part;

/* Which stretch holds a scaled moment; beyond the ends the last one there. */
static int stretch_of(const wb_cut *cut, double along) {
    int low = 0, high = cut->stretches;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (cut->stations[middle] <= along) low = middle;
        else high = middle;
    }
    return low;
}

/* `PureMomentCut.read`. */
static void read_cut(const wb_cut *cut, double moment, alone_part *out) {
    double along = moment / *cut->scale;
    memset(out, 0, sizeof *out);
    out->state = WB_OFF_HULL;
    if (!cut->stretches) return;
    int found = stretch_of(cut, along);
    const double *p = cut->pieces + 30 * (int64_t)found, *r = cut->rest + 12 * (int64_t)found;
    double y = along - cut->stations[found];
    for (int q = 0; q < 6; q++) {
        out->outputs[q] = p[q] + y * p[6 + q];
        out->bends[q] = p[12 + q] + y * (p[18 + q] + y * p[24 + q]);
        out->rest[q] = r[q] + y * r[6 + q];
        out->slopes[q] = p[6 + q] / *cut->scale;
        out->bend_slopes[q] = (p[18 + q] + 2 * y * p[24 + q]) / *cut->scale;
    }
    if (!(along < cut->stations[0] - ON_HULL) && !(along > cut->stations[cut->stretches] + ON_HULL))
        out->state = cut->state[found];
}

/* `Composition._alone`: from the axis the moment comes first in, or from the other one. */
static void read_alone(const wb_composition *c, int moment, double amount, alone_part *out) {
    int load = moment + 3, unknown = amount != 0 && !c->fit.known[load];
    memset(out, 0, sizeof *out);
    out->state = WB_NO_ROWS;
    for (int q = 0; q < 6; q++) {
        double slope = c->fit.matrix[6 * q + load];
        out->outputs[q] = c->rest_point[q] + amount * slope;
        out->rest[q] = unknown ? NAN : fabs(amount) * fabs(slope) + c->fit.bar[q];
        out->slopes[q] = slope;
    }
    for (int k = 0; k < 2; k++) {
        const wb_cut *cut = &c->cuts[moment][k];
        alone_part other;
        if (!cut->present || out->state < WB_OFF_HULL) continue;
        read_cut(cut, amount, &other);
        if (other.state < out->state) *out = other;
    }
}

static int worse(int a, int b) { return a > b ? a : b; }

static void put_translation(wb_composed *out, int axis, double moved, double bend, double rest) {
    out->moved[axis] = moved, out->bend[axis] = bend, out->squares[axis] = rest * rest;
}

static void add_rotation(wb_composed *out, const double *zero, const double *moved,
                         const double *bend, const double *rest, double times) {
    for (int k = 0; k < 3; k++) {
        double wide = times * rest[k];
        out->moved[3 + k] += times * (moved[k] - zero[3 + k]);
        out->bend[3 + k] += times * bend[k];
        out->squares[3 + k] += wide * wide;
    }
}

/* `Composition.evaluate`. */
void wb_compose(const wb_composition *c, const double small[6], const double wrench[6],
                wb_composed *out) {
    int loaded[6], states[3] = {0, 0, 0};
    double times[3];
    alone_part alone[3];
    for (int k = 0; k < 6; k++) loaded[k] = fabs(wrench[k]) > small[k];
    for (int q = 0; q < 6; q++) {
        out->moved[q] = c->rest_point[q], out->bend[q] = 0.0;
        out->squares[q] = c->rest_point[6 + q] * c->rest_point[6 + q];
    }
    for (int m = 0; m < 3; m++) {
        times[m] = loaded[3 + m] ? -1.0 : 0.0;
        if (loaded[3 + m]) read_alone(c, m, wrench[3 + m], &alone[m]);
    }
    for (int axis = 0; axis < 3; axis++) {
        int first = (axis + 1) % 3, second = (axis + 2) % 3;
        int force = loaded[axis], one = loaded[3 + first], two = loaded[3 + second];
        if (force || (one && two)) {
            wb_part part;
            wb_axis_part(c, axis, wrench, 0, &part);
            put_translation(out, axis, part.outputs[0], part.bends[0], part.rest[0]);
            add_rotation(out, c->rest_point, part.outputs + 1, part.bends + 1, part.rest + 1, 1.0);
            states[axis] = part.state;
        } else if (one || two) {
            int m = one ? first : second;
            times[m] += 1.0;
            put_translation(out, axis, alone[m].outputs[axis], alone[m].bends[axis],
                            alone[m].rest[axis]);
            states[axis] = alone[m].state;
        }
    }
    for (int m = 0; m < 3; m++) {
        if (times[m] == 0.0) continue;
        add_rotation(out, c->rest_point, alone[m].outputs + 3, alone[m].bends + 3, alone[m].rest + 3,
                     times[m]);
        int base = (m + 2) % 3; /* the axis that the moment comes first in */
        states[base] = worse(states[base], alone[m].state);
    }
    out->state = worse(worse(states[0], states[1]), states[2]);
}

/* `Composition.derivatives`. */
void wb_compose_derivative(const wb_composition *c, const double wrench[6], int bent,
                           double derivative[36]) {
    memset(derivative, 0, 36 * sizeof(double));
    for (int axis = 0; axis < 3; axis++) {
        int inputs[3] = {axis, 3 + (axis + 1) % 3, 3 + (axis + 2) % 3};
        wb_part part;
        wb_axis_part(c, axis, wrench, 1, &part);
        for (int q = 0; q < 4; q++)
            for (int i = 0; i < 3; i++) {
                double slope = part.slopes[q][i];
                if (bent) slope += part.bend_slopes[q][i];
                derivative[6 * (q == 0 ? axis : 2 + q) + inputs[i]] += slope;
            }
    }
    for (int m = 0; m < 3; m++) {
        alone_part alone;
        read_alone(c, m, wrench[3 + m], &alone);
        for (int q = 3; q < 6; q++)
            derivative[6 * q + 3 + m] -= alone.slopes[q] + (bent ? alone.bend_slopes[q] : 0.0);
    }
}
