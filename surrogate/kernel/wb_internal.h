/* Structures and functions that the files of the kernel share. MIT license, as all of wrenchbook.
 *
 * Arrays point into the mapped file; surrogate/packed/arrays.py names their shapes and units. The
 * order of all sums is fixed, so that one wrench, a batch and any number of threads give the same
 * bits.
 */
#ifndef WB_INTERNAL_H
#define WB_INTERNAL_H

#include "wrenchbook.h"

#include <math.h>

/* As in Python (tests/surrogate/kernel). Fractions of the load range: WB_ZERO_LOAD, a smaller load
 * is zero; WB_NEAR, closer wrenches are equal, and a load this close beyond an end is on it.
 * WB_ROUNDING: rounding error of an answer over its size. WB_STEEPER: largest growth of a response
 * over a proportional one. */
#define WB_ZERO_LOAD 1e-9
#define WB_NEAR 1e-6
#define WB_ROUNDING 1e-12
#define WB_STEEPER 2.0

enum { WB_F8 = 1, WB_I4 = 2, WB_I8 = 3, WB_U1 = 4 }; /* types of arrays */
/* State of an axis' part of an answer, from the best to the worst. */
enum { WB_INSIDE = 0, WB_OFF_HULL = 9, WB_NO_ROWS = 10 };
enum { WB_PANEL = 16, WB_LANES = 8 }; /* rows of a triangle at once; partial sums of a product */

/* 128 bytes, two cache lines: the data of one step of a walk through the triangulation. */
typedef struct {
    int32_t vertex[4], neighbour[4];
    double map[9], anchor[3]; /* slopes of the barycentric coordinates, position of the last vertex */
} wb_simplex;

/* The data of a point for an answer. */
typedef struct {
    double position[3], value[6];
} wb_vertex;

typedef struct {
    int32_t dimension, first_cell, cells[3];
} wb_axis_ints;

typedef struct {
    double scale[3], origin[3], basis[9], slack, corner[3], density[3];
} wb_axis_floats;

/* Answers of a single moment: piecewise polynomials of the scaled moment. */
typedef struct {
    int present, stretches;
    int64_t buckets;
    double scale;
    const double *stations, *outputs, *bucket;
    const int32_t *state, *start;
} wb_cut;

typedef struct {
    const double *matrix, *bar, *offset; /* (m, n); (m); (m) or NULL: at zero load */
    const int32_t *known;       /* (n) */
} wb_fit;

typedef struct {
    int64_t points, simplices, cells;
    const wb_simplex *simplex;
    const wb_vertex *vertex;
    const double *slopes, *zero_load;
    const unsigned char *degenerate;
    const wb_axis_ints *ints;
    const wb_axis_floats *floats;
    const int32_t *grid, *facets, *facet_first, *simplex_first, *point_first;
    wb_cut cuts[3][2];
    const wb_fit *fit;
} wb_composition;

/* The neighbourhoods that give sigma of the outputs of one factor. */
typedef struct {
    int padded; /* equations of a neighbourhood, a multiple of WB_PANEL */
    int64_t count;
    const int32_t *outputs, *number, *equations;
    const double *term, *rates; /* of the covariance: each term, and the last one, of all loads */
    const double *panels, *trend, *min_variance, *penalty, *mean_covariance;
    const double *scale, *max_sigma; /* of the calibration: (m), (1) */
} wb_factor;

typedef struct {
    int stride, terms, factors; /* stride: rows, a multiple of WB_LANES */
    int has_second, per_row; /* whether rows bring second derivatives; numbers of a row */
    const double *x, *term, *weights, *coefficients, *centre, *rate, *offset, *spread;
    const double *deviation, *lost, *floor, *tangent, *span, *together;
    const int32_t *smoothness, *factor_count; /* smoothness: NULL without second derivatives */
    wb_factor *factor;
} wb_kriging;

typedef struct {
    int64_t count, tangents, buckets;
    const double *key, *rates, *steepest, *wrench, *moved, *bar, *tangent, *bucket;
    const int32_t *number, *tangent_of, *start;
    const int64_t *seq;
} wb_rows;

/* A group: outputs with the same rows. */
typedef struct {
    int method, exact_fit, used, has_rows, has_composition, has_kriging;
    const int32_t *flags, *outputs, *held; /* held: NULL where it has those outputs alone */
    const int32_t *judged;                 /* outputs that decide its coverage: read ones, else held */
    const double *allowed;
    wb_fit fit;
    wb_rows rows;
    wb_composition composition;
    wb_kriging kriging;
} wb_group;

typedef struct {
    int by_tangent, mesh_known, linear, linearity_known, whole, none;
    const int32_t *flags;
    const double *mesh, *linearity, *one_over, *stiffness;
    const double *saturation; /* (m), NULL for zeros */
    const double *second; /* (m, n, n), NULL where the linearity error begins with its square */
    const double *zero;   /* (n): origin of the inputs, NULL for zeros */
} wb_solver;

struct wb_table {
    const unsigned char *bytes;
    size_t size, mapped; /* bytes; of those mapped by wb_open, 0 if the caller owns them */
    const unsigned char *directory;
    uint64_t arrays;
    const char *json;
    int inputs, outputs, groups, max_stride, max_flat, max_terms, max_padded;
    int vectors; /* triples of outputs whose length is limited */
    const int32_t *sizes, *locked, *vector_first;
    const double *ends, *scale, *small, *tolerance, *limit, *vector_limit;
    const double *rig_error; /* (m), NULL for none */
    const double *scene_ends; /* (2, n) of a table cut to a scene, else NULL */
    const int32_t *scene_varying, *scene_slopes;
    wb_solver solver;
    wb_group *group;
    wb_factor *factor;
};

/* Working memory of one answer; pointers into a scratch. */
typedef struct {
    double *apart, *flat, *first, *second, *chosen, *reduced, *wide;
    const wb_factor *of; /* the factor whose covariances with the wrench are in `wide`, or NULL */
    double moved[WB_MAX]; /* outputs of the answer, those too that a scene does not read */
} wb_work;

/* One group's answer, before the solver's part of the error. */
typedef struct {
    double outputs[WB_MAX], error[WB_MAX];
    int coverage, method, exact, reasons, by_row;
    int64_t row; /* index among the group's rows, or -1 */
    uint64_t solved; /* as in wb_reply */
    wb_reason reason[WB_MAX_REASONS];
} wb_result;

/* One axis' answer, all six outputs, its slopes by its three loads (N and N·m). */
typedef struct {
    double outputs[6], slopes[6][3];
    int state, simplex;
} wb_part;

/* The point of an axis for a wrench: scaled loads, the point in use, its barycentric weights. */
typedef struct {
    double x[3], at[3], weights[4];
    int simplex, inside;
} wb_location;

/* Three axes together: `moved` is the sum of all axes, `griddata` has each translation from its axis
 * alone. `times`: number of added parts less that of subtracted parts. */
typedef struct {
    double moved[6], griddata[3], times;
    int states[3], state;
} wb_composed;

/* numpy's maximum: NaN if either is NaN. */
static inline double wb_larger(double a, double b) { return isnan(a) || a > b ? a : b; }

/* A matrix (rows, columns) times a vector. */
static inline void wb_times(const double *matrix, const double *by, int rows, int columns, double *out) {
    for (int i = 0; i < rows; i++) {
        out[i] = 0;
        for (int j = 0; j < columns; j++) out[i] += matrix[columns * i + j] * by[j];
    }
}

/* The bucket of a number among ascending ones: start[bucket] to start[bucket + 1] bound its index.
 * `buckets_of` in surrogate/packed/axes_arrays.py makes the starts. */
static inline int64_t wb_bucket(double value, const double *bucket, int64_t buckets) {
    double index = (value - bucket[0]) * bucket[1];
    if (!(index > 0.0)) return 0;
    return index >= (double)(buckets - 1) ? buckets - 1 : (int64_t)index;
}

/* Each file calls functions of the files above it only (tests/surrogate/kernel/test_layers.py);
 * wb_joint.c is the last. */

/* wb_file.c */
void wb_unmap(wb_table *t);

/* wb_open.c */
wb_work wb_work_of(const wb_table *t, void *scratch);

/* wb_walk.c */
int wb_locate(const wb_composition *c, int axis, const double x[3], double weights[4]);
int wb_hint(const wb_composition *c, int axis, const double x[3]);
void wb_flat(const wb_composition *c, int axis, const double x[3], double flat[3]);
void wb_barycentric(const wb_composition *c, int simplex, const double flat[3], double weights[4]);
int wb_nearest_on_hull(const wb_composition *c, int axis, const double x[3], double at[3],
                       double weights[4]);

/* wb_axes.c */
void wb_axis_part(const wb_composition *c, int axis, const double wrench[6], int with_slopes,
                  wb_part *part);
void wb_axis_locate(const wb_composition *c, int axis, const double wrench[6], wb_location *location);
void wb_axis_read(const wb_composition *c, int axis, const double wrench[6], const wb_location *location,
                  int with_slopes, wb_part *part);

/* wb_compose.c */
int wb_cut_state(const wb_cut *cut, double moment);
void wb_compose_start(const wb_composition *c, wb_composed *out);
int wb_needs_axis(const double small[6], const double wrench[6], int axis);
void wb_add_axis(const wb_part *part, int axis, wb_composed *out);
void wb_add_moments(const wb_composition *c, const double small[6], const double wrench[6],
                    wb_composed *out);
void wb_compose(const wb_composition *c, const double small[6], const double wrench[6],
                wb_composed *out);
void wb_compose_derivative(const wb_composition *c, const double wrench[6], int method,
                           double derivative[36]);

/* wb_rows.c */
wb_reason *wb_add_reason(wb_result *a, int code);
int wb_method_of(const wb_group *g, const wb_options *o);
double wb_allowed(const wb_group *g, const wb_options *o, int q);
int wb_is_beyond(const wb_table *t, const double *w);
int wb_leaves_scene(const wb_table *t, const double *w);
int64_t wb_find_row(const wb_table *t, const wb_group *g, const double *w);
int wb_answer_by_row(const wb_table *t, const wb_group *g, const wb_options *o, const double *w,
                     wb_result *a);

/* wb_kriging.c */
int wb_anchor(const wb_table *t, const wb_kriging *k, const double *wrench, wb_work *work);
void wb_kriging_outputs(const wb_table *t, const wb_kriging *k, wb_work *work,
                        const double *wrench, double *outputs);
void wb_kriging_values(const wb_table *t, const wb_kriging *k, wb_work *work,
                       const double *wrench, double *outputs, double *error);
void wb_kriging_reasons(const wb_table *t, const wb_kriging *k, wb_work *work, const double *w,
                        wb_result *a);
void wb_kriging_derivative(const wb_table *t, const wb_kriging *k, wb_work *work,
                           const double *wrench, double *derivative);
void wb_kriging_along(const wb_table *t, const wb_kriging *k, wb_work *work, const double *wrench,
                      const double *direction, double *slopes);

/* wb_reason.c */
void wb_axes_reasons(const wb_table *t, const wb_group *g, const double *w, wb_result *a);

/* wb_answer.c */
void wb_group_answer(const wb_table *t, const wb_group *g, const wb_options *o, wb_work *work,
                     const double *w, const wb_composed *composed, int with_reasons, wb_result *a);
void wb_group_slopes(const wb_table *t, const wb_group *g, wb_work *work, const double *w,
                     int method, double *derivative);
void wb_group_along(const wb_table *t, const wb_group *g, wb_work *work, const double *w, int method,
                    const double *direction, double *slopes);

/* wb_reply.c */
void wb_reply_of(const wb_table *t, const wb_options *o, wb_work *work, const double *inputs,
                 const wb_composed *composed, int with_reasons, wb_reply *reply);
void wb_conclude(const wb_table *t, const wb_options *o, wb_work *work, wb_reply *reply);
void wb_reply_derivative(const wb_table *t, const wb_options *o, wb_work *work,
                         const wb_reply *reply, double *derivative);
void wb_answer_slopes(const wb_table *t, const wb_options *o, wb_work *work, const double *inputs,
                      double *derivative);
int wb_check(const wb_table *t, const wb_options *o, const double *inputs);

/* wb_many.c */
/* Work on the blocks first, first + step, ... of a job; returns WB_OK or an error. */
typedef int (*wb_run)(void *job, size_t first, size_t step);
/* Share the blocks of a job among threads; the calling one is the first of them. */
int wb_share(wb_run run, void *job, size_t blocks, int threads);

/* wb_inverse.c */
int wb_eliminate(double *a, double *b, int count, int right);

#endif
