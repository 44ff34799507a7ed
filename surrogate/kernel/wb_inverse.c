/* The wrench of a displacement by Newton's method: DESIGN section 11. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <string.h>

enum { MAX_STEPS = 40, MAX_HALVINGS = 12 };
/* Of the load range: a step that no displacement of a table shows, and one below which rounding can
 * always keep the next from being shorter. */
static const double SMALL_STEP = 1e-12, ROUNDING_STEP = 1e-9;
/* How much shorter each step is while the matrix of another wrench is good enough. */
static const double GAIN = 0.1;

/* What the iteration works with: the free loads and the outputs of the same numbers. */
typedef struct {
    const wb_table *t;
    wb_options o;
    wb_work work;
    int count, free[WB_MAX];
    double matrix[WB_MAX * WB_MAX], size[WB_MAX];
} solver;

static int all_finite(const solver *s, const double *numbers, int stride) {
    for (int i = 0; i < s->count; i++)
        for (int k = 0; k < stride; k++)
            if (!isfinite(numbers[stride * s->free[i] + k])) return 0;
    return 1;
}

/* The method's displacement, with no row and no limit in its place; 0 if it is not known, as of an
 * output that no group holds. */
static int outputs_at(solver *s, const double *w, double *outputs) {
    wb_result result;
    for (int q = 0; q < s->t->outputs; q++) outputs[q] = NAN;
    for (int i = 0; i < s->t->groups; i++) {
        const wb_group *g = &s->t->group[i];
        if (g->used && wb_method_of(g, &s->o) == WB_KRIGING)
            wb_kriging_outputs(s->t, &g->kriging, &s->work, w, result.outputs);
        else
            wb_group_answer(s->t, g, &s->o, &s->work, w, NULL, 0, &result);
        for (int q = 0; q < s->t->outputs; q++)
            if (g->outputs[q]) outputs[q] = result.outputs[q];
    }
    return all_finite(s, outputs, 1);
}

/* Its slopes (m, n); 0 if they are not known. */
static int slopes_at(solver *s, const double *w, double *slopes) {
    int n = s->t->inputs;
    double group_slopes[WB_MAX * WB_MAX];
    for (int k = 0; k < s->t->outputs * n; k++) slopes[k] = NAN;
    for (int i = 0; i < s->t->groups; i++) {
        const wb_group *g = &s->t->group[i];
        wb_group_slopes(s->t, g, &s->work, w, wb_method_of(g, &s->o), group_slopes);
        for (int q = 0; q < s->t->outputs; q++)
            if (g->outputs[q]) memcpy(slopes + n * q, group_slopes + n * q, (size_t)n * sizeof(double));
    }
    return all_finite(s, slopes, n);
}

/* Solve a x = b (count, right) in place by elimination with row pivots; 0 if a is singular. */
int wb_eliminate(double *a, double *b, int count, int right) {
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
        double largest = 0;
        for (int j = 0; j < s->count; j++) {
            int load = s->free[j];
            largest = fmax(largest, fabs(slopes[s->t->inputs * s->free[i] + load]) * s->t->scale[load]);
        }
        s->size[i] = largest > 0 ? largest : 1.0;
    }
}

/* The inverse of du/dw (n, m) by this method; zero for locked inputs. */
static int invert(solver *s, const double *w, double *stiffness) {
    int n = s->t->inputs, m = s->t->outputs, count = s->count;
    double slopes[WB_MAX * WB_MAX], unit[WB_MAX * WB_MAX];
    memset(stiffness, 0, (size_t)(n * m) * sizeof(double));
    memset(unit, 0, (size_t)(count * count) * sizeof(double));
    if (!slopes_at(s, w, slopes)) return WB_SINGULAR;
    sizes_of(s, slopes);
    scaled_matrix(s, slopes);
    for (int i = 0; i < count; i++) unit[count * i + i] = 1.0;
    if (!wb_eliminate(s->matrix, unit, count, count)) return WB_SINGULAR;
    for (int i = 0; i < count; i++)
        for (int j = 0; j < count; j++) {
            int load = s->free[i], q = s->free[j];
            stiffness[m * load + q] = unit[count * i + j] * s->t->scale[load] / s->size[j];
        }
    return WB_OK;
}

/* The step of the loads by a stiffness, over their scales; returns its largest. */
static double step_by(const solver *s, const double *stiffness, const double *residual, double *step) {
    double largest = 0;
    for (int i = 0; i < s->count; i++) {
        int load = s->free[i];
        step[i] = 0;
        for (int j = 0; j < s->count; j++)
            step[i] += stiffness[s->t->outputs * load + s->free[j]] * residual[j];
        step[i] /= s->t->scale[load];
        largest = fmax(largest, fabs(step[i]));
    }
    return largest;
}

/* Try a fraction of a step: where it leads to, the residual there, and the next step from there by
 * the same matrix; returns its largest, infinite if the method has no answer there. */
static double try_step(solver *s, const double *target, const double *stiffness, double fraction,
                       const double *w, const double *step, double *there, double *next) {
    double outputs[WB_MAX], residual[WB_MAX];
    memcpy(there, w, (size_t)s->t->inputs * sizeof(double));
    for (int i = 0; i < s->count; i++) {
        int load = s->free[i];
        there[load] += fraction * step[i] * s->t->scale[load];
    }
    if (!outputs_at(s, there, outputs)) return INFINITY;
    for (int i = 0; i < s->count; i++) residual[i] = target[s->free[i]] - outputs[s->free[i]];
    return step_by(s, stiffness, residual, next);
}

/* The largest step that rounding of the outputs can make: a kriging's sums lose more than others. */
static double step_of_rounding(const solver *s, const double *stiffness) {
    double largest = ROUNDING_STEP, lost[WB_MAX] = {0};
    for (int i = 0; i < s->t->groups; i++) {
        const wb_group *g = &s->t->group[i];
        if (!g->used || wb_method_of(g, &s->o) != WB_KRIGING) continue;
        for (int q = 0; q < s->t->outputs; q++)
            if (g->outputs[q]) lost[q] = g->kriging.lost[q];
    }
    for (int i = 0; i < s->count; i++) {
        int load = s->free[i];
        double step = 0;
        for (int j = 0; j < s->count; j++)
            step += fabs(stiffness[s->t->outputs * load + s->free[j]]) * lost[s->free[j]];
        largest = fmax(largest, step / s->t->scale[load]);
    }
    return largest;
}

/* Newton's method with the natural monotonicity test (Deuflhard 2004): the next step by the same
 * matrix must be shorter. The matrix stays while each is shorter by GAIN. */
static int iterate(solver *s, const double *target, double *w, double *stiffness, int fresh) {
    static const double none[WB_MAX];
    double step[WB_MAX], next[WB_MAX], there[WB_MAX];
    double largest = try_step(s, target, stiffness, 0.0, w, none, there, step);
    for (int count = 0; count < MAX_STEPS; count++) {
        if (!isfinite(largest)) return WB_SINGULAR;
        double floor = step_of_rounding(s, stiffness);
        double fraction = 1.0, after = try_step(s, target, stiffness, fraction, w, step, there, next);
        if (largest <= SMALL_STEP || (largest <= floor && !(after <= GAIN * largest))) {
            if (after <= largest) memcpy(w, there, (size_t)s->t->inputs * sizeof(double));
            return WB_OK;
        }
        if (!fresh && !(after <= GAIN * largest)) { /* a matrix of another wrench */
            int wrong = invert(s, w, stiffness);
            if (wrong) return wrong;
            largest = try_step(s, target, stiffness, 0.0, w, none, there, step), fresh = 1;
            continue;
        }
        for (int half = 0; half < MAX_HALVINGS && !(after < largest); half++)
            after = try_step(s, target, stiffness, fraction *= 0.5, w, step, there, next);
        if (!(after < largest)) return largest <= floor ? WB_OK : WB_NO_CONVERGENCE;
        memcpy(w, there, (size_t)s->t->inputs * sizeof(double));
        memcpy(step, next, sizeof step);
        largest = after, fresh = 0;
    }
    return WB_NO_CONVERGENCE;
}

int wb_inverse(const wb_table *t, const wb_options *options, const double *outputs, double *inputs,
               double *stiffness, void *scratch) {
    solver s;
    if (t->inputs < t->outputs) return WB_NOT_SQUARE; /* loads come first, in the outputs' order */
    s.t = t, s.o = options ? *options : (wb_options){WB_DEFAULT, NULL, 1};
    s.o.without_rows = 1, s.work = wb_work_of(t, scratch), s.count = 0;
    int wrong = wb_check(t, &s.o, inputs);
    if (wrong) return wrong;
    for (int k = 0; k < t->outputs; k++) {
        if (t->locked[k]) inputs[k] = 0.0;
        else s.free[s.count++] = k;
        if (!t->locked[k] && !isfinite(outputs[k])) return WB_NOT_FINITE;
    }
    int known = 0;
    for (int k = 0; k < t->inputs * t->outputs; k++) known |= stiffness[k] != 0.0;
    if (!known && (wrong = invert(&s, inputs, stiffness))) return wrong;
    int result = iterate(&s, outputs, inputs, stiffness, !known);
    if (result == WB_SINGULAR) return result;
    wrong = invert(&s, inputs, stiffness);
    return result ? result : wrong;
}
