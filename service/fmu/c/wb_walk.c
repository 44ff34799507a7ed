/* Find the simplex of a point by walking: surrogate/interpolation/walk.py. MIT license. */
#include "wb_table.h"

#include <math.h>

static const double INSIDE = -1e-13; /* rounding may have put a point outside by this much */
static const double ON_HULL = 1e-9;  /* that far beyond the hull counts as on it */
static const int MOST_STEPS = 100000;

static int cell(double place, int cells) {
    /* Compared before it is made whole: a huge number has no int. */
    if (!(place > 0.0)) return 0;
    return place >= cells - 1 ? cells - 1 : (int)place;
}

static int hint(const wb_composition *c, int axis, const double flat[3]) {
    const double *floats = c->floats + WB_AXIS_FLOATS * axis;
    const int32_t *ints = c->ints + WB_AXIS_INTS * axis;
    int i[3];
    for (int k = 0; k < 3; k++)
        i[k] = cell((flat[k] - floats[WB_CORNER + k]) * floats[WB_DENSITY + k],
                    ints[WB_CELLS + k]);
    int64_t at = ((int64_t)i[0] * ints[WB_CELLS + 1] + i[1]) * ints[WB_CELLS + 2] + i[2];
    return c->grid[ints[WB_FIRST_CELL] + at];
}

void wb_shares(const wb_composition *c, int axis, int simplex, const double flat[3],
               double shares[4]) {
    const double *m = c->maps + (int64_t)WB_MAP * simplex;
    double p = flat[0] - m[9], q = flat[1] - m[10], r = flat[2] - m[11];
    (void)axis;
    shares[0] = m[0] * p + m[1] * q + m[2] * r;
    shares[1] = m[3] * p + m[4] * q + m[5] * r;
    shares[2] = m[6] * p + m[7] * q + m[8] * r;
    shares[3] = 1.0 - shares[0] - shares[1] - shares[2];
}

/* The place of the smallest barycentric coordinate; the last one's is 3 in `shares`. */
static int worst_of(const double shares[4], int dimension, double *least) {
    int worst = 0;
    *least = shares[0];
    for (int k = 1; k < dimension; k++)
        if (shares[k] < *least) { worst = k; *least = shares[k]; }
    if (shares[3] < *least) { worst = dimension; *least = shares[3]; }
    return worst;
}

/* Look at every simplex that is not degenerate: where a walk goes in circles. */
static int find_slowly(const wb_composition *c, int axis, const double flat[3], double shares[4]) {
    int dimension = c->ints[WB_AXIS_INTS * axis], best = -1;
    double most = -ON_HULL, least;
    for (int s = c->simplex_first[axis]; s < c->simplex_first[axis + 1]; s++) {
        if (c->simplex[(int64_t)WB_SIMPLEX * s + WB_STATE] == WB_DEGENERATE) continue;
        wb_shares(c, axis, s, flat, shares);
        worst_of(shares, dimension, &least);
        if (least >= most) { most = least; best = s; }
    }
    if (best >= 0) wb_shares(c, axis, best, flat, shares);
    return best;
}

static int find(const wb_composition *c, int axis, const double flat[3], double shares[4]) {
    int dimension = c->ints[WB_AXIS_INTS * axis], here = hint(c, axis, flat);
    for (int step = 0; step < MOST_STEPS; step++) {
        const int32_t *simplex = c->simplex + (int64_t)WB_SIMPLEX * here;
        double least;
        int worst, there = here;
        if (simplex[WB_STATE] == WB_DEGENERATE) break;
        wb_shares(c, axis, here, flat, shares);
        worst = worst_of(shares, dimension, &least);
        if (least < INSIDE) {
            there = simplex[WB_NEIGHBOUR + worst];
            if (there < 0 && least < -ON_HULL) return -1;
        }
        if (there == here || there < 0) return here;
        here = there;
    }
    return find_slowly(c, axis, flat, shares);
}

void wb_flat(const wb_composition *c, int axis, const double x[3], double flat[3]) {
    const double *f = c->floats + WB_AXIS_FLOATS * axis;
    double a, b, d;
    if (c->ints[WB_AXIS_INTS * axis] == 3) {
        for (int k = 0; k < 3; k++) flat[k] = x[k];
        return;
    }
    a = x[0] - f[WB_ORIGIN], b = x[1] - f[WB_ORIGIN + 1], d = x[2] - f[WB_ORIGIN + 2];
    flat[0] = a * f[WB_BASIS] + b * f[WB_BASIS + 1] + d * f[WB_BASIS + 2];
    flat[1] = a * f[WB_BASIS + 3] + b * f[WB_BASIS + 4] + d * f[WB_BASIS + 5];
    flat[2] = 0.0;
}

/* Whether a point lies in what the triangulation's points span. */
static int is_held(const wb_composition *c, int axis, const double x[3], const double flat[3]) {
    const double *f = c->floats + WB_AXIS_FLOATS * axis;
    if (c->ints[WB_AXIS_INTS * axis] == 3) return 1;
    for (int k = 0; k < 3; k++) {
        double off = x[k] - f[WB_ORIGIN + k];
        off -= flat[0] * f[WB_BASIS + k] + flat[1] * f[WB_BASIS + 3 + k];
        if (!(fabs(off) <= f[WB_SLACK])) return 0;
    }
    return 1;
}

/* `Triangulation.locate`: the simplex of a scaled point and its shares there, or -1. */
int wb_locate(const wb_composition *c, int axis, const double x[3], double shares[4]) {
    double flat[3];
    wb_flat(c, axis, x, flat);
    if (!isfinite(flat[0] + flat[1] + flat[2]) || !is_held(c, axis, x, flat)) return -1;
    if (c->ints[WB_AXIS_INTS * axis] == 0) {
        wb_shares(c, axis, c->simplex_first[axis], flat, shares);
        return c->simplex_first[axis];
    }
    return find(c, axis, flat, shares);
}
