/* A wrenchbook table as flat arrays, and what answers from it. MIT license, as all of wrenchbook.
 *
 * Units are SI: N, N·m, m, rad. Six numbers are force then moment, or translation then rotation.
 * Everything is read from one file, once, and never written: any number of threads may answer from
 * one table, each with a workspace of its own. The algorithms and the order of their sums are those
 * of wrenchbook's room `surrogate`; each function names the one that it follows.
 */
#ifndef WB_TABLE_H
#define WB_TABLE_H

#include <stddef.h>
#include <stdint.h>

#define WB_GUID 40 /* bytes of a GUID in braces, with the final zero, and one to spare */

/* Columns, as in surrogate/interpolation/walk.py. */
enum { WB_VALUE = 3, WB_REST = 19, WB_VERTEX = 23, WB_MAP = 12 };
enum { WB_NEIGHBOUR = 4, WB_STATE = 8, WB_SIMPLEX = 9 };
enum { WB_DIMENSION = 0, WB_FIRST_CELL = 1, WB_CELLS = 2, WB_AXIS_INTS = 5 };
enum { WB_SCALE = 0, WB_ORIGIN = 3, WB_BASIS = 6, WB_SLACK = 15, WB_CORNER = 16, WB_DENSITY = 19,
       WB_AXIS_FLOATS = 22 };
/* What an answer rests on: surrogate/composition, `axis_table` and `composition`. */
enum { WB_SOUND = 0, WB_DEGENERATE = 2, WB_OFF_HULL = 9, WB_NO_ROWS = 10 };
/* surrogate/answer.py */
enum { WB_COVERED = 0, WB_THIN = 1, WB_OUTSIDE = 2 };
/* surrogate/methods: how a group answers, and what its bars are held against. */
enum { WB_GRIDDATA = 0, WB_TANGENT = 1, WB_KRIGING = 2, WB_LINEAR = 3, WB_NEAREST = 4 };
enum { WB_NO_REFERENCE = -1, WB_BENDS = 0, WB_MISSED = 1, WB_ITSELF = 2 };

/* The answers to one moment alone: `PureMomentCut`. */
typedef struct {
    int present, stretches;
    const double *stations, *pieces, *rest, *scale;
    const int32_t *state;
} wb_cut;

/* The 6x6 compliance: `ComplianceFit`. */
typedef struct {
    const double *matrix, *bar;
    const int32_t *known;
} wb_fit;

/* Three axes and the answer at no load: `Packed`, with what its kernels do not need. */
typedef struct {
    int64_t points, simplices;
    const double *vertex, *maps, *place, *slopes, *floats, *rest_point;
    const int32_t *simplex, *grid, *ints, *facets, *facet_first, *simplex_first;
    wb_cut cuts[3][2];
    wb_fit fit;
} wb_composition;

/* The neighbourhoods that tell sigma for some outputs. */
typedef struct {
    int equations, levels;
    const int32_t *outputs, *places;
    const double *reduce, *unsettled, *least, *mean_covariance, *sigma, *factors;
} wb_share;

/* A dense kriging: `surrogate.kriging.compiled.Tables`. */
typedef struct {
    int rows, shares;
    const double *x, *terms, *weights, *coefficients, *scales, *floor, *tangent, *span;
    wb_share *share;
} wb_kriging;

/* One surrogate: the outputs that the same rows hold. */
typedef struct {
    int method, reference, knows_interaction, rest_unknown;
    int has_composition, has_kriging, has_fit, exact_fit, nearest_rows, rows, tangents;
    const int32_t *outputs, *row_number, *row_tangent;
    const double *low, *high, *small, *allowed, *scale;
    const double *row_key, *row_rate, *steepest;
    const double *row_wrench, *row_displacement, *row_bar, *tangent;
    const double *nearest_wrench, *nearest_displacement;
    wb_composition composition;
    wb_kriging kriging;
    wb_fit fit;
} wb_group;

/* A table. `bytes` holds all arrays. */
typedef struct {
    char guid[WB_GUID];
    int groups, most_rows, most_equations;
    const double *mesh, *bends, *one_over; /* the solver's own share of the bars, */
    const double *stiffer, *asks;          /* and where it grows by an answer's tangent */
    const double *limit; /* whether bars are whole, and the component's tolerance, m and rad */
    wb_group *group;
    wb_share *share;
    unsigned char *bytes;
} wb_table;

/* What one evaluation writes to; as many of them as there are threads. */
typedef struct {
    double *across, *first, *second, *apart, *chosen, *reduced;
} wb_workspace;

typedef struct {
    double displacement[6], error[6];
    int coverage, by_row;
    int within; /* 1: the whole bar is within the tolerance; 0: it is not; -1: not known */
} wb_answer;

typedef void *(*wb_allocate)(size_t count, size_t size);
typedef void (*wb_free)(void *object);

/* Read a table; returns NULL and, in `why`, a reason of at most `size` bytes. */
wb_table *wb_table_read(const char *path, wb_allocate allocate, wb_free free_, char *why,
                        size_t size);
void wb_table_free(wb_table *table, wb_free free_);
wb_workspace *wb_workspace_new(const wb_table *table, wb_allocate allocate, wb_free free_);
void wb_workspace_free(wb_workspace *work, wb_free free_);

/* Answer six finite loads. `tolerance`: translation m, rotation rad; zero for the table's own. */
void wb_answer_at(const wb_table *table, wb_workspace *work, const double wrench[6],
                  const double tolerance[2], wb_answer *answer);
/* Fill du/dw, 6 x 6 row by row, of that answer; NaN where it is not known. */
void wb_derivative_at(const wb_table *table, wb_workspace *work, const double wrench[6],
                      const wb_answer *answer, double derivative[36]);

/* Between the files of this folder. */
typedef struct {
    double outputs[4], bends[4], rest[4];
    double slopes[4][3], bend_slopes[4][3];
    int state;
} wb_part;
typedef struct {
    double moved[6], bend[6], squares[6];
    int state;
} wb_composed;

int wb_locate(const wb_composition *c, int axis, const double x[3], double shares[4]);
void wb_flat(const wb_composition *c, int axis, const double x[3], double flat[3]);
void wb_shares(const wb_composition *c, int axis, int simplex, const double flat[3],
               double shares[4]);
int wb_nearest_on_hull(const wb_composition *c, int axis, const double x[3], double at[3],
                       double shares[4]);
void wb_axis_part(const wb_composition *c, int axis, const double wrench[6], int with_slopes,
                  wb_part *part);
void wb_compose(const wb_composition *c, const double small[6], const double wrench[6],
                wb_composed *out);
void wb_compose_derivative(const wb_composition *c, const double wrench[6], int bent,
                           double derivative[36]);
void wb_kriging_values(const wb_kriging *k, wb_workspace *work, const double wrench[6],
                       double displacement[6], double bar[6]);
void wb_kriging_derivative(const wb_kriging *k, wb_workspace *work, const double wrench[6],
                           double derivative[36]);

#endif
