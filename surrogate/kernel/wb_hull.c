/* The nearest point of a hull: surrogate/interpolation/hull.py is the builder's. MIT license. */
#include "wb_internal.h"

#include <float.h>
#include <math.h>
#include <string.h>

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
    double share = fmin(fmax(dot(apart, along) / length, 0.0), 1.0);
    for (int k = 0; k < 3; k++) at[k] = a[k] + share * along[k];
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
        double place[3];
        on_stretch(corner[edge], corner[(edge + 1) % 3], x, place);
        double away = squared(place, x);
        if (away < best) { best = away; memcpy(at, place, sizeof place); }
    }
}

static void on_facet(const wb_composition *c, const int32_t *facet, int corners, const double x[3],
                     double at[3]) {
    const double *corner[3] = {0, 0, 0};
    for (int k = 0; k < corners; k++) corner[k] = c->vertex[facet[k]].place;
    if (corners == 1) memcpy(at, corner[0], 3 * sizeof(double));
    else if (corners == 2) on_stretch(corner[0], corner[1], x, at);
    else on_triangle(corner, x, at);
}

/* The nearest point of the hull to a point outside it, a simplex that holds it and its shares. */
int wb_nearest_on_hull(const wb_composition *c, int axis, const double x[3], double at[3],
                       double shares[4]) {
    const wb_axis_floats *f = &c->floats[axis];
    int dimension = c->ints[axis].dimension, found = -1;
    double flat[3], place[3], near[3], best = INFINITY;
    memcpy(place, x, sizeof place);
    if (dimension < 3) { /* the foot in the plane or line of the points, if the hull holds that */
        wb_flat(c, axis, x, flat);
        for (int k = 0; k < 3; k++)
            place[k] = f->origin[k] + flat[0] * f->basis[k] + flat[1] * f->basis[3 + k];
        memcpy(at, place, sizeof place);
        found = wb_locate(c, axis, place, shares);
        if (found >= 0) return found;
    }
    for (int facet = c->facet_first[axis]; facet < c->facet_first[axis + 1]; facet++) {
        const int32_t *one = c->facets + 4 * (int64_t)facet;
        on_facet(c, one, dimension, place, near);
        double away = squared(near, place);
        if (away < best || found < 0) { best = away, found = one[3]; memcpy(at, near, sizeof near); }
    }
    if (found < 0) { /* a point alone, and a place that is not a number */
        found = c->simplex_first[axis];
        memcpy(at, c->vertex[c->point_first[axis]].place, 3 * sizeof(double));
    }
    wb_flat(c, axis, at, flat);
    wb_shares(c, found, flat, shares);
    return found;
}
