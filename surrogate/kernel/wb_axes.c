/* What one axis answers. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

static void inputs_of(int axis, int inputs[3]) {
    inputs[0] = axis, inputs[1] = 3 + (axis + 1) % 3, inputs[2] = 3 + (axis + 2) % 3;
}

/* The index in `weights` of a simplex' corner: that of the last corner is 3. */
static int weight_at(int corner, int dimension) { return corner < dimension ? corner : 3; }

/* A corner's point; the first point in place of an index that leads out of the table. */
static int64_t point_of(const wb_composition *c, int simplex, int corner) {
    int32_t point = c->simplex[simplex].vertex[corner];
    return point >= 0 && point < c->points ? point : 0;
}

/* Outputs at a point of a simplex. */
static void read_values(const wb_composition *c, int axis, int simplex, const double weights[4],
                        wb_part *part) {
    int dimension = c->ints[axis].dimension;
    for (int corner = 0; corner <= dimension; corner++) {
        const wb_vertex *v = c->vertex + point_of(c, simplex, corner);
        double weight = weights[weight_at(corner, dimension)];
        for (int q = 0; q < 6; q++) part->outputs[q] += weight * v->value[q];
    }
}

/* Slopes by the scaled loads, within a simplex. */
static void read_slopes(const wb_composition *c, int axis, int simplex, wb_part *part) {
    const double *map = c->simplex[simplex].map, *basis = c->floats[axis].basis;
    int dimension = c->ints[axis].dimension;
    const double *last = c->vertex[point_of(c, simplex, dimension)].value;
    for (int corner = 0; corner < dimension; corner++) {
        const double *value = c->vertex[point_of(c, simplex, corner)].value;
        double by[3] = {0.0, 0.0, 0.0}; /* the slopes of the corner's barycentric coordinate */
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < dimension; j++) by[i] += map[3 * corner + j] * basis[3 * j + i];
        for (int q = 0; q < 6; q++)
            for (int i = 0; i < 3; i++) part->slopes[q][i] += (value[q] - last[q]) * by[i];
    }
}

/* Keep of slopes by the scaled loads what lies along the span of the points. */
static void keep_along(const wb_composition *c, int axis, double slopes[6][3]) {
    const double *basis = c->floats[axis].basis;
    int dimension = c->ints[axis].dimension;
    if (dimension < 3)
        for (int q = 0; q < 6; q++) {
            double along[3] = {0.0, 0.0, 0.0};
            for (int j = 0; j < dimension; j++)
                for (int i = 0; i < 3; i++) along[j] += slopes[q][i] * basis[3 * j + i];
            for (int i = 0; i < 3; i++) {
                slopes[q][i] = 0.0;
                for (int j = 0; j < dimension; j++) slopes[q][i] += along[j] * basis[3 * j + i];
            }
        }
}

/* Add the slopes off the span of the points: the fitted compliance, NaN by loads that it lacks. */
static void add_off_span(const wb_composition *c, int axis, wb_part *part) {
    const wb_axis_floats *f = &c->floats[axis];
    int dimension = c->ints[axis].dimension, inputs[3];
    inputs_of(axis, inputs);
    if (dimension < 3)
        for (int i = 0; i < 3; i++)
            for (int j = 0; j < 3; j++) {
                double off = i == j ? 1.0 : 0.0;
            for (int k = 0; k < dimension; k++) off -= f->basis[3 * k + i] * f->basis[3 * k + j];
            if (!(fabs(off) > WB_ZERO_LOAD)) continue;
            for (int q = 0; q < 6; q++) {
                double slope = f->scale[j] * c->fit->matrix[6 * q + inputs[j]];
                part->slopes[q][i] += c->fit->known[inputs[j]] ? off * slope : NAN;
            }
        }
}

/* Slopes blended from the vertices: those along the hull's outside. */
static void blend_slopes(const wb_composition *c, int axis, int simplex, const double weights[4],
                         wb_part *part) {
    int dimension = c->ints[axis].dimension;
    memset(part->slopes, 0, sizeof part->slopes);
    for (int corner = 0; corner <= dimension; corner++) {
        const double *slope = c->slopes + 18 * point_of(c, simplex, corner);
        for (int q = 0; q < 6; q++)
            for (int i = 0; i < 3; i++)
                part->slopes[q][i] += weights[weight_at(corner, dimension)] * slope[3 * q + i];
    }
    keep_along(c, axis, part->slopes);
}

/* The step off what the points span, by the fitted compliance. */
static void step_off_plane(const wb_composition *c, int axis, const double step[3],
                           wb_part *part) {
    const wb_axis_floats *f = &c->floats[axis];
    int dimension = c->ints[axis].dimension, inputs[3];
    double off[3], along[3] = {0.0, 0.0, 0.0}, largest = 0.0;
    if (dimension == 3) return;
    inputs_of(axis, inputs);
    for (int j = 0; j < dimension; j++)
        for (int i = 0; i < 3; i++) along[j] += step[i] * f->basis[3 * j + i];
    for (int i = 0; i < 3; i++) {
        double in = 0.0;
        for (int j = 0; j < dimension; j++) in += along[j] * f->basis[3 * j + i];
        off[i] = step[i] - in;
        largest = fmax(largest, fabs(off[i]));
    }
    if (!(largest > WB_ZERO_LOAD)) return;
    for (int q = 0; q < 6; q++) {
        const double *row = c->fit->matrix + 6 * q;
        double more = 0.0;
        for (int i = 0; i < 3; i++) more += off[i] * f->scale[i] * row[inputs[i]];
        part->outputs[q] += more;
    }
}

/* From the hull's nearest point to the point asked: outputs by the slope there. */
static void step_off(const wb_composition *c, int axis, const double step[3], wb_part *part) {
    for (int q = 0; q < 6; q++) {
        double moved = 0.0;
        for (int i = 0; i < 3; i++) moved += part->slopes[q][i] * step[i];
        part->outputs[q] += moved;
    }
    step_off_plane(c, axis, step, part);
}

/* The fitted compliance's part, for an axis that has no rows. */
static void guess(const wb_composition *c, int axis, const double wrench[6], wb_part *part) {
    int inputs[3];
    inputs_of(axis, inputs);
    for (int q = 0; q < 6; q++) {
        const double *row = c->fit->matrix + 6 * q;
        double moved = 0.0;
        for (int i = 0; i < 3; i++) {
            moved += wrench[inputs[i]] * row[inputs[i]];
            part->slopes[q][i] = row[inputs[i]];
        }
        part->outputs[q] = c->zero_load[q] + moved;
    }
    part->state = WB_NO_ROWS, part->simplex = -1;
}

/* Where an axis is read for a wrench: the simplex, or the nearest point of the hull. */
void wb_axis_locate(const wb_composition *c, int axis, const double wrench[6], wb_location *location) {
    int inputs[3];
    location->simplex = -1, location->inside = 1;
    if (c->ints[axis].dimension < 0) return;
    const double *scale = c->floats[axis].scale;
    inputs_of(axis, inputs);
    for (int i = 0; i < 3; i++) location->at[i] = location->x[i] = wrench[inputs[i]] / scale[i];
    location->simplex = wb_locate(c, axis, location->x, location->weights);
    location->inside = location->simplex >= 0;
    if (!location->inside)
        location->simplex = wb_nearest_on_hull(c, axis, location->x, location->at, location->weights);
}

/* All six outputs; slopes by the axis' loads, N and N·m. */
void wb_axis_read(const wb_composition *c, int axis, const double wrench[6], const wb_location *location,
                  int with_slopes, wb_part *part) {
    double step[3];
    int simplex = location->simplex;
    memset(part, 0, with_slopes || !location->inside || simplex < 0 ? sizeof *part
                                                               : offsetof(wb_part, slopes));
    if (simplex < 0) {
        guess(c, axis, wrench, part);
        return;
    }
    part->state = location->inside ? WB_INSIDE : WB_OFF_HULL, part->simplex = simplex;
    read_values(c, axis, simplex, location->weights, part);
    if (!location->inside) {
        for (int i = 0; i < 3; i++) step[i] = location->x[i] - location->at[i];
        blend_slopes(c, axis, simplex, location->weights, part);
        step_off(c, axis, step, part);
    } else if (with_slopes) {
        read_slopes(c, axis, simplex, part);
    }
    if (with_slopes) add_off_span(c, axis, part);
    const double *scale = c->floats[axis].scale;
    if (with_slopes)
        for (int q = 0; q < 6; q++)
            for (int i = 0; i < 3; i++) part->slopes[q][i] /= scale[i];
}

void wb_axis_part(const wb_composition *c, int axis, const double wrench[6], int with_slopes,
                  wb_part *part) {
    wb_location location;
    wb_axis_locate(c, axis, wrench, &location);
    wb_axis_read(c, axis, wrench, &location, with_slopes, part);
}
