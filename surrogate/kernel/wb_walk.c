/* The simplex of a point by walking, and the nearest point of a hull. MIT license.
 *
 * A walk starts from the simplex that a grid names for the point's cell, whatever was asked before,
 * so that an answer does not depend on the order of a batch. Indices are checked as they are
 * followed: a damaged triangulation ends a walk, it leads nowhere else.
 */
#include "wb_internal.h"

#include <float.h>
#include <math.h>
#include <string.h>

static const double INSIDE = -1e-13; /* rounding may have put a point outside by this much */
static const double ON_HULL = 1e-9;  /* a point that far beyond the hull counts as on it */
static const int MAX_STEPS = 100000; /* a longer walk goes in circles between flat simplices */

static int cell(double position, int cells) {
    /* Compared before it is made whole: a huge number has no int. */
    if (!(position > 0.0)) return 0;
    return position >= cells - 1 ? cells - 1 : (int)position;
}

static int hint(const wb_composition *c, int axis, const double flat[3]) {
    const wb_axis_floats *f = &c->floats[axis];
    const wb_axis_ints *ints = &c->ints[axis];
    int64_t at = 0;
    for (int k = 0; k < 3; k++)
        at = at * ints->cells[k] + cell((flat[k] - f->corner[k]) * f->density[k], ints->cells[k]);
    int simplex = c->grid[ints->first_cell + at];
    return simplex >= c->simplex_first[axis] && simplex < c->simplex_first[axis + 1]
               ? simplex : c->simplex_first[axis];
}

/* Where the walk to a scaled point starts: points with equal hints are close to each other. */
int wb_hint(const wb_composition *c, int axis, const double x[3]) {
    double flat[3];
    wb_flat(c, axis, x, flat);
    return hint(c, axis, flat);
}

void wb_barycentric(const wb_composition *c, int simplex, const double flat[3], double weights[4]) {
    const double *m = c->simplex[simplex].map, *at = c->simplex[simplex].anchor;
    double p = flat[0] - at[0], q = flat[1] - at[1], r = flat[2] - at[2];
    weights[0] = m[0] * p + m[1] * q + m[2] * r;
    weights[1] = m[3] * p + m[4] * q + m[5] * r;
    weights[2] = m[6] * p + m[7] * q + m[8] * r;
    weights[3] = 1.0 - weights[0] - weights[1] - weights[2];
}

/* The corner of the smallest barycentric coordinate; that of the last corner is weights[3]. */
static int worst_of(const double weights[4], int dimension, double *smallest) {
    int worst = 0;
    *smallest = weights[0];
    for (int k = 1; k < dimension; k++)
        if (weights[k] < *smallest) { worst = k; *smallest = weights[k]; }
    if (weights[3] < *smallest) { worst = dimension; *smallest = weights[3]; }
    return worst;
}

/* Look at every simplex that is not degenerate: where a walk goes in circles. */
static int find_slowly(const wb_composition *c, int axis, const double flat[3], double weights[4]) {
    int dimension = c->ints[axis].dimension, best = -1;
    double largest = -ON_HULL, smallest;
    for (int s = c->simplex_first[axis]; s < c->simplex_first[axis + 1]; s++) {
        if (c->degenerate[s]) continue;
        wb_barycentric(c, s, flat, weights);
        worst_of(weights, dimension, &smallest);
        if (smallest >= largest) { largest = smallest; best = s; }
    }
    if (best >= 0) wb_barycentric(c, best, flat, weights);
    return best;
}

static int find(const wb_composition *c, int axis, const double flat[3], double weights[4]) {
    int dimension = c->ints[axis].dimension, here = hint(c, axis, flat);
    for (int step = 0; step < MAX_STEPS; step++) {
        double smallest;
        if (c->degenerate[here]) break;
        wb_barycentric(c, here, flat, weights);
        int worst = worst_of(weights, dimension, &smallest);
        if (smallest >= INSIDE) return here;
        int there = c->simplex[here].neighbour[worst];
        if (there < 0 && smallest < -ON_HULL) return -1;
        if (there < 0 || there == here) return here;
        if (there >= c->simplices) break;
        here = there;
    }
    return find_slowly(c, axis, flat, weights);
}

void wb_flat(const wb_composition *c, int axis, const double x[3], double flat[3]) {
    const wb_axis_floats *f = &c->floats[axis];
    if (c->ints[axis].dimension == 3) {
        for (int k = 0; k < 3; k++) flat[k] = x[k];
        return;
    }
    double a = x[0] - f->origin[0], b = x[1] - f->origin[1], d = x[2] - f->origin[2];
    flat[0] = a * f->basis[0] + b * f->basis[1] + d * f->basis[2];
    flat[1] = a * f->basis[3] + b * f->basis[4] + d * f->basis[5];
    flat[2] = 0.0;
}

/* Whether a point lies in what the triangulation's points span. */
static int is_held(const wb_composition *c, int axis, const double x[3], const double flat[3]) {
    const wb_axis_floats *f = &c->floats[axis];
    if (c->ints[axis].dimension == 3) return 1;
    for (int k = 0; k < 3; k++) {
        double off = x[k] - f->origin[k];
        off -= flat[0] * f->basis[k] + flat[1] * f->basis[3 + k];
        if (!(fabs(off) <= f->slack)) return 0;
    }
    return 1;
}

/* The simplex of a scaled point and its barycentric weights there, or -1. */
int wb_locate(const wb_composition *c, int axis, const double x[3], double weights[4]) {
    double flat[3];
    wb_flat(c, axis, x, flat);
    if (!isfinite(flat[0] + flat[1] + flat[2]) || !is_held(c, axis, x, flat)) return -1;
    if (c->ints[axis].dimension == 0) {
        wb_barycentric(c, c->simplex_first[axis], flat, weights);
        return c->simplex_first[axis];
    }
    return find(c, axis, flat, weights);
}

static double squared(const double a[3], const double b[3]) {
    double x = a[0] - b[0], y = a[1] - b[1], z = a[2] - b[2];
    return x * x + y * y + z * z;
}

static double dot(const double a[3], const double b[3]) {
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void on_stretch(const double *a, const double *b, const double x[3], double at[3]) {
    double along[3], apart[3];
    for (int k = 0; k < 3; k++) along[k] = b[k] - a[k], apart[k] = x[k] - a[k];
    double length = fmax(dot(along, along), DBL_MIN);
    double fraction = fmin(fmax(dot(apart, along) / length, 0.0), 1.0);
    for (int k = 0; k < 3; k++) at[k] = a[k] + fraction * along[k];
}

/* The foot of the perpendicular if the triangle holds it, else the nearest of its edges. */
static void on_triangle(const double *const corner[3], const double x[3], double at[3]) {
    double e[3], f[3], apart[3], best = INFINITY;
    for (int k = 0; k < 3; k++) {
        e[k] = corner[1][k] - corner[0][k];
        f[k] = corner[2][k] - corner[0][k];
        apart[k] = x[k] - corner[0][k];
    }
    double ee = dot(e, e), ef = dot(e, f), ff = dot(f, f);
    double pe = dot(apart, e), pf = dot(apart, f), area = ee * ff - ef * ef;
    double s = (ff * pe - ef * pf) / area, t = (ee * pf - ef * pe) / area;
    if (s >= 0 && t >= 0 && s + t <= 1) {
        for (int k = 0; k < 3; k++) at[k] = corner[0][k] + s * e[k] + t * f[k];
        return;
    }
    for (int edge = 0; edge < 3; edge++) {
        double position[3];
        on_stretch(corner[edge], corner[(edge + 1) % 3], x, position);
        double away = squared(position, x);
        if (away < best) { best = away; memcpy(at, position, sizeof position); }
    }
}

static void on_facet(const wb_composition *c, const int32_t *facet, int corners, const double x[3],
                     double at[3]) {
    const double *corner[3] = {0, 0, 0};
    for (int k = 0; k < corners; k++) corner[k] = c->vertex[facet[k]].position;
    if (corners == 1) memcpy(at, corner[0], 3 * sizeof(double));
    else if (corners == 2) on_stretch(corner[0], corner[1], x, at);
    else on_triangle(corner, x, at);
}

/* The nearest point of the hull to a point outside it, a simplex that holds it and its weights. */
int wb_nearest_on_hull(const wb_composition *c, int axis, const double x[3], double at[3],
                       double weights[4]) {
    const wb_axis_floats *f = &c->floats[axis];
    int dimension = c->ints[axis].dimension, simplex = -1;
    double flat[3], position[3], near[3], best = INFINITY;
    memcpy(position, x, sizeof position);
    if (dimension < 3) { /* the foot in the plane or line of the points, if the hull holds that */
        wb_flat(c, axis, x, flat);
        for (int k = 0; k < 3; k++)
            position[k] = f->origin[k] + flat[0] * f->basis[k] + flat[1] * f->basis[3 + k];
        memcpy(at, position, sizeof position);
        simplex = wb_locate(c, axis, position, weights);
        if (simplex >= 0) return simplex;
    }
    for (int facet = c->facet_first[axis]; facet < c->facet_first[axis + 1]; facet++) {
        const int32_t *corners = c->facets + 4 * (int64_t)facet;
        on_facet(c, corners, dimension, position, near);
        double away = squared(near, position);
        if (away < best || simplex < 0) { best = away, simplex = corners[3]; memcpy(at, near, sizeof near); }
    }
    if (simplex < 0) { /* a point alone, and a position that is not a number */
        simplex = c->simplex_first[axis];
        memcpy(at, c->vertex[c->point_first[axis]].position, 3 * sizeof(double));
    }
    wb_flat(c, axis, at, flat);
    wb_barycentric(c, simplex, flat, weights);
    return simplex;
}
