/* What one axis answers: surrogate/composition/axis_table.py and `Composition._read`. MIT. */
#include "wb_table.h"

#include <math.h>
#include <string.h>

static const double CLEAN = 1e-9; /* of the range: below it a load counts as none */

static const double *slope_of(const wb_composition *c, int point, int output) {
    return c->slopes + 12 * (int64_t)point + 3 * output;
}

/* The place in `shares` of a simplex' corner: that of the last one is 3. */
static int share_at(int corner, int dimension) { return corner < dimension ? corner : 3; }

/* The slopes of a simplex' barycentric coordinates by the three scaled loads. */
static void share_slopes(const wb_composition *c, int axis, int simplex, double out[4][3]) {
    const double *map = c->maps + (int64_t)WB_MAP * simplex;
    const double *basis = c->floats + WB_AXIS_FLOATS * axis + WB_BASIS;
    int dimension = c->ints[WB_AXIS_INTS * axis];
    memset(out, 0, 12 * sizeof(double));
    for (int corner = 0; corner < dimension; corner++)
        for (int i = 0; i < 3; i++) {
            double sum = 0.0;
            for (int j = 0; j < dimension; j++) sum += map[3 * corner + j] * basis[3 * j + i];
            out[corner][i] = sum;
            out[3][i] -= sum;
        }
}

/* `AxisTable.read_in`, without slopes. */
static void read_values(const wb_composition *c, int axis, int simplex, const double at[3],
                        const double shares[4], double rises[4][4], wb_part *part) {
    const int32_t *corners = c->simplex + (int64_t)WB_SIMPLEX * simplex;
    int dimension = c->ints[WB_AXIS_INTS * axis];
    for (int corner = 0; corner <= dimension; corner++) {
        const double *vertex = c->vertex + (int64_t)WB_VERTEX * corners[corner];
        const double *place = c->place + 3 * (int64_t)corners[corner];
        double share = shares[share_at(corner, dimension)];
        for (int q = 0; q < 4; q++) {
            const double *slope = slope_of(c, corners[corner], q);
            double rise = 0.0;
            for (int i = 0; i < 3; i++) rise += slope[i] * (at[i] - place[i]);
            rises[corner][q] = 0.5 * rise;
            part->outputs[q] += share * vertex[WB_VALUE + q];
            part->rest[q] += share * vertex[WB_REST + q];
            part->bends[q] += share * rises[corner][q];
        }
    }
}

static void read_slopes(const wb_composition *c, int axis, int simplex, const double shares[4],
                        double rises[4][4], wb_part *part) {
    const int32_t *corners = c->simplex + (int64_t)WB_SIMPLEX * simplex;
    int dimension = c->ints[WB_AXIS_INTS * axis];
    const double *last = c->vertex + (int64_t)WB_VERTEX * corners[dimension] + WB_VALUE;
    double by[4][3];
    share_slopes(c, axis, simplex, by);
    for (int corner = 0; corner <= dimension; corner++) {
        const double *value = c->vertex + (int64_t)WB_VERTEX * corners[corner] + WB_VALUE;
        int at = share_at(corner, dimension);
        for (int q = 0; q < 4; q++) {
            const double *slope = slope_of(c, corners[corner], q);
            for (int i = 0; i < 3; i++) {
                if (corner < dimension) part->slopes[q][i] += (value[q] - last[q]) * by[corner][i];
                part->bend_slopes[q][i] += by[at][i] * rises[corner][q];
                part->bend_slopes[q][i] += 0.5 * shares[at] * slope[i];
            }
        }
    }
}

/* Slopes blended from the vertices: those along the hull's outside. */
static void blend_slopes(const wb_composition *c, int axis, int simplex, const double shares[4],
                         wb_part *part) {
    const int32_t *corners = c->simplex + (int64_t)WB_SIMPLEX * simplex;
    int dimension = c->ints[WB_AXIS_INTS * axis];
    memset(part->slopes, 0, sizeof part->slopes);
    memset(part->bend_slopes, 0, sizeof part->bend_slopes);
    for (int corner = 0; corner <= dimension; corner++)
        for (int q = 0; q < 4; q++)
            for (int i = 0; i < 3; i++)
                part->slopes[q][i] += shares[share_at(corner, dimension)]
                                      * slope_of(c, corners[corner], q)[i];
}

/* What an axis' output q is among the six. */
static int output_at(int axis, int q) { return q == 0 ? axis : 2 + q; }

static void inputs_of(int axis, int inputs[3]) {
    inputs[0] = axis, inputs[1] = 3 + (axis + 1) % 3, inputs[2] = 3 + (axis + 2) % 3;
}

/* The step off what the points span, by the fitted compliance: `Composition._step_off`. */
static void step_off_plane(const wb_composition *c, int axis, const double step[3],
                           wb_part *part) {
    const double *f = c->floats + WB_AXIS_FLOATS * axis, *basis = f + WB_BASIS;
    int dimension = c->ints[WB_AXIS_INTS * axis], inputs[3], unknown = 0;
    double off[3], along[3] = {0.0, 0.0, 0.0}, most = 0.0;
    if (dimension == 3) return;
    inputs_of(axis, inputs);
    for (int j = 0; j < dimension; j++)
        for (int i = 0; i < 3; i++) along[j] += step[i] * basis[3 * j + i];
    for (int i = 0; i < 3; i++) {
        double in = 0.0;
        for (int j = 0; j < dimension; j++) in += along[j] * basis[3 * j + i];
        off[i] = step[i] - in;
        most = fmax(most, fabs(off[i]));
        unknown |= fabs(off[i]) > CLEAN && !c->fit.known[inputs[i]];
    }
    if (!(most > CLEAN)) return;
    for (int q = 0; q < 4; q++) {
        const double *row = c->fit.matrix + 6 * output_at(axis, q);
        double more = 0.0, size = 0.0;
        for (int i = 0; i < 3; i++) {
            double load = off[i] * f[WB_SCALE + i];
            more += load * row[inputs[i]];
            size += fabs(load) * fabs(row[inputs[i]]);
        }
        part->outputs[q] += more;
        part->rest[q] = unknown ? NAN : part->rest[q] + (size + c->fit.bar[output_at(axis, q)]);
    }
}

/* From the hull's nearest point to the point asked: outputs by the slope there, wider bars. */
static void step_off(const wb_composition *c, int axis, const double step[3], wb_part *part) {
    for (int q = 0; q < 4; q++) {
        double moved = 0.0;
        for (int i = 0; i < 3; i++) moved += part->slopes[q][i] * step[i];
        part->outputs[q] += moved;
        part->rest[q] += fabs(moved);
    }
    step_off_plane(c, axis, step, part);
}

/* The fitted compliance's part, for an axis that has no rows: `Composition._guess`. */
static void guess(const wb_composition *c, int axis, const double wrench[6], wb_part *part) {
    int inputs[3], unknown = 0;
    inputs_of(axis, inputs);
    for (int i = 0; i < 3; i++) unknown |= wrench[inputs[i]] != 0 && !c->fit.known[inputs[i]];
    for (int q = 0; q < 4; q++) {
        int output = output_at(axis, q);
        const double *row = c->fit.matrix + 6 * output;
        double moved = 0.0, size = 0.0;
        for (int i = 0; i < 3; i++) {
            moved += wrench[inputs[i]] * row[inputs[i]];
            size += fabs(wrench[inputs[i]]) * fabs(row[inputs[i]]);
            part->slopes[q][i] = row[inputs[i]];
        }
        part->outputs[q] = c->rest_point[output] + moved;
        part->rest[q] = unknown ? NAN : size + c->fit.bar[output];
    }
    part->state = WB_NO_ROWS;
}

/* `Composition._read`: outputs are the axis' own four; slopes by its loads, N and N·m. */
void wb_axis_part(const wb_composition *c, int axis, const double wrench[6], int with_slopes,
                  wb_part *part) {
    const double *scale = c->floats + WB_AXIS_FLOATS * axis + WB_SCALE;
    double x[3], at[3], step[3], shares[4], rises[4][4];
    int inputs[3];
    memset(part, 0, sizeof *part);
    if (c->ints[WB_AXIS_INTS * axis] < 0) {
        guess(c, axis, wrench, part);
        return;
    }
    inputs_of(axis, inputs);
    for (int i = 0; i < 3; i++) at[i] = x[i] = wrench[inputs[i]] / scale[i];
    int found = wb_locate(c, axis, x, shares), inside = found >= 0;
    if (!inside) found = wb_nearest_on_hull(c, axis, x, at, shares);
    part->state = inside ? c->simplex[(int64_t)WB_SIMPLEX * found + WB_STATE] : WB_OFF_HULL;
    read_values(c, axis, found, at, shares, rises, part);
    if (!inside) {
        for (int i = 0; i < 3; i++) step[i] = x[i] - at[i];
        blend_slopes(c, axis, found, shares, part);
        step_off(c, axis, step, part);
    } else if (with_slopes) {
        read_slopes(c, axis, found, shares, rises, part);
    }
    for (int q = 0; with_slopes && q < 4; q++)
        for (int i = 0; i < 3; i++) part->slopes[q][i] /= scale[i], part->bend_slopes[q][i] /= scale[i];
}
