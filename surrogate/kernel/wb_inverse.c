/* The wrench of a displacement by Newton's method: DESIGN section 11. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

enum { MOST_STEPS = 20, MOST_HALVINGS = 12 };
/* Of the load range: a step that no displacement of a table shows. */
static const double SMALL_STEP = 1e-12;

static const wb_options OWN = {WB_DEFAULT, NULL};

/* What the iteration works with: the free loads and the outputs of the same numbers. */
typedef struct {
    const wb_table *t;
    const wb_options *o;
    wb_work work;
    int count, free[WB_MOST];
    double matrix[WB_MOST * WB_MOST], missed[WB_MOST], size[WB_MOST];
} solver;

/* The method's displacement and slopes, with no row and no limit in their place. */
static int evaluate(solver *s, const double *w, double *outputs, double *slopes) {
    const wb_table *t = s->t;
    int n = t->inputs;
    double own[WB_MOST * WB_MOST];
    for (int i = 0; i < t->groups; i++) {
        const wb_group *g = &t->group[i];
        wb_found found;
        wb_group_answer(t, g, s->o, &s->work, w, 0, &found);
        if (found.method == WB_ROW) { /* the interpolant, without the row */
            wb_group bare = *g;
            bare.rows.count = 0;
            wb_group_answer(t, &bare, s->o, &s->work, w, 0, &found);
        }
        if (slopes) wb_group_slopes(t, g, &s->work, w, wb_method_of(g, s->o), own);
        for (int q = 0; q < t->outputs; q++) {
            if (!g->outputs[q]) continue;
            outputs[q] = found.outputs[q];
            if (slopes) memcpy(slopes + n * q, own + n * q, (size_t)n * sizeof(double));
        }
    }
    for (int i = 0; i < s->count; i++)
        if (!isfinite(outputs[s->free[i]])) return 0;
    return 1;
}

/* Solve a x = b (count, right) in place by elimination with row pivots; 0 if a is singular. */
static int eliminate(double *a, double *b, int count, int right) {
    for (int k = 0; k < count; k++) {
        int best = k;
        for (int i = k + 1; i < count; i++)
            if (fabs(a[count * i + k]) > fabs(a[count * best + k])) best = i;
        if (!(fabs(a[count * best + k]) > 0) || !isfinite(a[count * best + k])) return 0;
        for (int j = 0; j < count && best != k; j++) {
            double held = a[count * k + j];
            a[count * k + j] = a[count * best + j], a[count * best + j] = held;
        }
        for (int j = 0; j < right && best != k; j++) {
            double held = b[right * k + j];
            b[right * k + j] = b[right * best + j], b[right * best + j] = held;
        }
        for (int i = k + 1; i < count; i++) {
            double part = a[count * i + k] / a[count * k + k];
            for (int j = k; j < count; j++) a[count * i + j] -= part * a[count * k + j];
            for (int j = 0; j < right; j++) b[right * i + j] -= part * b[right * k + j];
        }
    }
    for (int k = count - 1; k >= 0; k--)
        for (int j = 0; j < right; j++) {
            for (int i = k + 1; i < count; i++) b[right * k + j] -= a[count * k + i] * b[right * i + j];
            b[right * k + j] /= a[count * k + k];
        }
    return 1;
}

/* The slopes of the free outputs by the free scaled loads, over the outputs' sizes. */
static void scaled_matrix(solver *s, const double *slopes) {
    for (int i = 0; i < s->count; i++)
        for (int j = 0; j < s->count; j++) {
            int q = s->free[i], load = s->free[j];
            s->matrix[s->count * i + j] =
                slopes[s->t->inputs * q + load] * s->t->scale[load] / s->size[i];
        }
}

/* What the full range moves each output by its largest slope: sizes that make rows alike. */
static void sizes_of(solver *s, const double *slopes) {
    for (int i = 0; i < s->count; i++) {
        double most = 0;
        for (int j = 0; j < s->count; j++) {
            int load = s->free[j];
            most = fmax(most, fabs(slopes[s->t->inputs * s->free[i] + load]) * s->t->scale[load]);
        }
        s->size[i] = most > 0 ? most : 1.0;
    }
}

static double residual(solver *s, const double *target, const double *outputs) {
    double sum = 0;
    for (int i = 0; i < s->count; i++) {
        s->missed[i] = (target[s->free[i]] - outputs[s->free[i]]) / s->size[i];
        sum += s->missed[i] * s->missed[i];
    }
    return sqrt(sum);
}

/* Go along a Newton step, halved until it comes nearer; returns the new residual. */
static double advance(solver *s, const double *target, const double *step, double before,
                      double *w) {
    double there[WB_MOST], outputs[WB_MOST], share = 1.0, after = before;
    for (int half = 0; half < MOST_HALVINGS; half++, share *= 0.5) {
        memcpy(there, w, (size_t)s->t->inputs * sizeof(double));
        for (int j = 0; j < s->count; j++)
            there[s->free[j]] += share * step[j] * s->t->scale[s->free[j]];
        if (!evaluate(s, there, outputs, NULL)) continue;
        after = residual(s, target, outputs);
        if (after < before) break;
    }
    if (after < before) memcpy(w, there, (size_t)s->t->inputs * sizeof(double));
    return after;
}

static int iterate(solver *s, const double *target, double *w) {
    double outputs[WB_MOST], slopes[WB_MOST * WB_MOST];
    for (int step = 0; step <= MOST_STEPS; step++) {
        double most = 0;
        if (!evaluate(s, w, outputs, slopes)) return WB_SINGULAR;
        if (step == 0) sizes_of(s, slopes);
        double before = residual(s, target, outputs);
        scaled_matrix(s, slopes);
        if (!eliminate(s->matrix, s->missed, s->count, 1)) return WB_SINGULAR;
        for (int j = 0; j < s->count; j++) most = fmax(most, fabs(s->missed[j]));
        if (!isfinite(most)) return WB_SINGULAR;
        if (most <= SMALL_STEP) return WB_OK;
        if (step == MOST_STEPS) break;
        double along[WB_MOST];
        memcpy(along, s->missed, (size_t)s->count * sizeof(double));
        double after = advance(s, target, along, before, w);
        if (!(after < before)) /* rounding is all that is left, or nothing leads nearer */
            return most <= 1e3 * SMALL_STEP ? WB_OK : WB_NO_CONVERGENCE;
    }
    return WB_NO_CONVERGENCE;
}

/* The inverse of du/dw (n, m); zero for locked inputs. */
static int invert(solver *s, const double *w, double *stiffness) {
    int n = s->t->inputs, count = s->count;
    double outputs[WB_MOST], slopes[WB_MOST * WB_MOST], unit[WB_MOST * WB_MOST] = {0};
    memset(stiffness, 0, (size_t)(n * n) * sizeof(double));
    if (!evaluate(s, w, outputs, slopes)) return WB_SINGULAR;
    scaled_matrix(s, slopes);
    for (int i = 0; i < count; i++) unit[count * i + i] = 1.0;
    if (!eliminate(s->matrix, unit, count, count)) return WB_SINGULAR;
    for (int i = 0; i < count; i++)
        for (int j = 0; j < count; j++) {
            int load = s->free[i], q = s->free[j];
            stiffness[n * load + q] = unit[count * i + j] * s->t->scale[load] / s->size[j];
        }
    return WB_OK;
}

int wb_inverse(const wb_table *t, const wb_options *options, const double *outputs, double *inputs,
               double *stiffness, void *scratch) {
    solver s;
    if (t->inputs != t->outputs) return WB_NOT_SQUARE;
    s.t = t, s.o = options ? options : &OWN, s.work = wb_work_of(t, scratch), s.count = 0;
    int wrong = wb_check(t, s.o, inputs);
    if (wrong) return wrong;
    for (int k = 0; k < t->inputs; k++) {
        if (t->locked[k]) inputs[k] = 0.0;
        else s.free[s.count++] = k;
        if (!t->locked[k] && !isfinite(outputs[k])) return WB_NOT_FINITE;
    }
    int found = iterate(&s, outputs, inputs);
    if (found == WB_SINGULAR) return found;
    wrong = invert(&s, inputs, stiffness);
    return found ? found : wrong;
}
