/* Methods, bars, coverage and rows: surrogate/surrogate.py and surrogate/methods. MIT license. */
#include "wb_table.h"

#include <math.h>
#include <string.h>

static const double ROUNDING = 1e-12; /* of an answer's size: methods/linear.py */

/* numpy's maximum: what is not a number wins. */
static double larger(double a, double b) { return isnan(a) || a > b ? a : b; }

/* The best estimate there is and its bars, where no composition is at hand: `Reference`. */
static void refer(const wb_group *g, wb_workspace *work, const double w[6], double best[6],
                  double bars[6]) {
    wb_composed composed;
    double missed[6], own[6];
    if (g->reference == WB_ITSELF) {
        wb_kriging_values(&g->kriging, work, w, best, bars);
        return;
    }
    wb_compose(&g->composition, g->small, w, &composed);
    for (int q = 0; q < 6; q++) {
        best[q] = composed.moved[q] + composed.bend[q];
        bars[q] = sqrt(composed.squares[q]);
    }
    if (g->reference != WB_MISSED) return;
    wb_kriging_values(&g->kriging, work, w, missed, own);
    for (int q = 0; q < 6; q++) {
        best[q] += missed[q];
        bars[q] = sqrt(bars[q] * bars[q] + own[q] * own[q]);
    }
}

/* `fast.judge`: |answer - reference| + bar of the reference. */
static void by_griddata(const wb_group *g, wb_workspace *work, const double w[6], wb_answer *a) {
    wb_composed c;
    double best[6] = {0}, own[6] = {0};
    wb_compose(&g->composition, g->small, w, &c);
    if (g->reference != WB_BENDS) wb_kriging_values(&g->kriging, work, w, best, own);
    int off = c.state >= WB_OFF_HULL;
    a->coverage = off ? WB_OUTSIDE : c.state > 0 ? WB_THIN : WB_COVERED;
    for (int q = 0; q < 6; q++) {
        double value = c.moved[q] + (g->method == WB_TANGENT ? c.bend[q] : 0.0), wrong, rest;
        if (g->reference == WB_ITSELF) {
            wrong = value - best[q], rest = own[q];
        } else {
            wrong = value - c.moved[q] - c.bend[q], rest = c.squares[q];
            if (g->reference == WB_MISSED) wrong -= best[q], rest += own[q] * own[q];
            rest = sqrt(rest);
        }
        a->displacement[q] = value;
        a->error[q] = fabs(wrong) + rest;
        /* As wrong as the step from the hull is long; of unknown length, as the bar is then. */
        if (off) a->error[q] = larger(sqrt(c.squares[q]), a->error[q]);
    }
}

/* `LoadRange.exceeded`, with the ends that the file brings. */
static int is_beyond(const wb_group *g, const double w[6]) {
    for (int k = 0; k < 6; k++)
        if (w[k] < g->low[k] || w[k] > g->high[k]) return 1;
    return 0;
}

static void by_linear(const wb_group *g, wb_workspace *work, const double w[6], wb_answer *a) {
    double best[6], bars[6];
    int unknown = 0;
    for (int k = 0; k < 6; k++) unknown |= !g->fit.known[k] && fabs(w[k]) > g->small[k];
    for (int q = 0; q < 6; q++) {
        const double *row = g->fit.matrix + 6 * q;
        double size = 0.0;
        a->displacement[q] = 0.0;
        for (int k = 0; k < 6; k++) {
            a->displacement[q] += w[k] * row[k];
            size += fabs(w[k]) * fabs(row[k]);
        }
        a->error[q] = g->fit.bar[q] + ROUNDING * size;
    }
    if (!g->exact_fit) {
        refer(g, work, w, best, bars);
        for (int q = 0; q < 6; q++)
            a->error[q] = larger(fabs(a->displacement[q] - best[q]) + bars[q], a->error[q]);
    }
    for (int q = 0; unknown && q < 6; q++) a->error[q] = NAN;
    a->coverage = unknown || is_beyond(g, w) ? WB_OUTSIDE : WB_COVERED;
}

static void by_nearest(const wb_group *g, wb_workspace *work, const double w[6], wb_answer *a) {
    double best[6], bars[6], closest = INFINITY;
    int found = 0;
    for (int row = 0; row < g->nearest_rows; row++) {
        double apart = 0.0;
        for (int k = 0; k < 6; k++) {
            double step = w[k] / g->scale[k] - g->nearest_wrench[6 * (int64_t)row + k];
            apart += step * step;
        }
        if (apart < closest) closest = apart, found = row;
    }
    refer(g, work, w, best, bars);
    for (int q = 0; q < 6; q++) {
        a->displacement[q] = g->nearest_displacement[6 * (int64_t)found + q];
        a->error[q] = fabs(a->displacement[q] - best[q]) + bars[q];
    }
    a->coverage = is_beyond(g, w) ? WB_OUTSIDE : WB_COVERED;
}

/* Whether a wrench loads more than one axis: not `clean_wrenches(...).any()`. */
static int loads_several(const wb_group *g, const double w[6]) {
    for (int axis = 0; axis < 3; axis++) {
        int foreign = 0;
        for (int k = 0; k < 6; k++)
            if (k != axis && k != 3 + (axis + 1) % 3 && k != 3 + (axis + 2) % 3)
                foreign |= fabs(w[k]) > g->small[k];
        if (!foreign) return 0;
    }
    return 1;
}

static int is_at_rest(const wb_group *g, const double w[6]) {
    for (int k = 0; k < 6; k++)
        if (!(fabs(w[k]) <= g->small[k])) return 0;
    return 1;
}

/* The largest bar of an output of a covered answer: `Allowed`. */
static double allowed_of(const wb_group *g, const double tolerance[2], int q) {
    return tolerance[0] > 0 && tolerance[1] > 0 ? tolerance[q / 3] : g->allowed[q];
}

#define NEAR 1e-6 /* of the range: rows closer than this, in each load, are one: `merging` */
#define WINDOW (NEAR * (1 + 1e-6))
#define STEEPER 2.0 /* exact_rows.py */

/* The nearest row within NEAR in each load, of equally near ones the first, or -1: `RowIndex`. */
static int find_row(const wb_group *g, const double w[6]) {
    int low = 0, high = g->rows, found = -1;
    double key = 0, closest = NEAR;
    for (int k = 0; k < 6; k++) key += w[k] * g->row_rate[k];
    while (low < high) {
        int middle = low + (high - low) / 2;
        if (g->row_key[middle] < key - WINDOW) low = middle + 1;
        else high = middle;
    }
    for (; low < g->rows && g->row_key[low] <= key + WINDOW; low++) {
        double apart = 0;
        for (int k = 0; k < 6; k++)
            apart = larger(fabs(g->row_wrench[6 * (int64_t)low + k] - w[k]) / g->scale[k], apart);
        if (apart > closest) continue;
        if (apart == closest && found >= 0 && g->row_number[low] > g->row_number[found]) continue;
        closest = apart, found = low;
    }
    return found;
}

/* What a row says at or beside its wrench, unless that is too far off: `ExactRows.at`. */
static int tell_row(const wb_group *g, int row, const double w[6], const double tolerance[2],
                    wb_answer *a) {
    const double *own = g->row_wrench + 6 * (int64_t)row;
    const double *moved = g->row_displacement + 6 * (int64_t)row;
    int place = g->row_tangent[row];
    const double *tangent = place < 0 ? NULL : g->tangent + 36 * (int64_t)place;
    double step[6], slope[6], displacement[6], error[6], reach = 0, far = 0, steep = 0;
    for (int k = 0; k < 6; k++) {
        step[k] = w[k] - own[k];
        reach = larger(fabs(step[k] / g->scale[k]), reach);
        far = larger(fabs(own[k] / g->scale[k]), far);
    }
    if (is_beyond(g, w) != is_beyond(g, own)) return 0;
    for (int q = 0; q < 6; q++) {
        const double *own3 = moved + q / 3 * 3; /* all translations, or all rotations */
        double most = larger(larger(fabs(own3[0]), fabs(own3[1])), fabs(own3[2]));
        slope[q] = g->steepest[q];
        if (far > 0) slope[q] = larger(STEEPER / far * most, slope[q]);
        steep = larger(slope[q], steep);
    }
    for (int q = 0; q < 6; q++) {
        double more = 0, growth = steep > 0 ? slope[q] * reach : NAN;
        for (int k = 0; tangent && k < 6; k++) more += tangent[6 * q + k] * step[k];
        if (tangent && isfinite(more)) growth = fabs(more);
        else more = 0;
        if (!(reach > 0)) more = growth = 0;
        if (!(growth <= allowed_of(g, tolerance, q))) return 0;
        displacement[q] = moved[q] + more;
        error[q] = g->row_bar[6 * (int64_t)row + q] + growth;
    }
    memcpy(a->displacement, displacement, sizeof displacement);
    memcpy(a->error, error, sizeof error);
    return 1;
}

/* What the bars and the table's doubts make of a method's answer: `Surrogate.batch`. */
static void judge(const wb_group *g, const double w[6], const double tolerance[2], wb_answer *a) {
    int over = 0, known = 1;
    for (int q = 0; q < 6; q++) {
        over |= !(a->error[q] <= allowed_of(g, tolerance, q));
        known &= isfinite(a->error[q]) != 0;
    }
    if (a->coverage == WB_COVERED && g->rest_unknown && is_at_rest(g, w)) a->coverage = WB_OUTSIDE;
    int doubtful = !g->knows_interaction && loads_several(g, w);
    if (a->coverage == WB_COVERED && (over || doubtful)) a->coverage = WB_THIN;
    for (int q = 0; !known && q < 6; q++) a->error[q] = NAN;
}

static void answer_of(const wb_group *g, wb_workspace *work, const double w[6],
                      const double tolerance[2], wb_answer *a) {
    int row;
    a->by_row = 0;
    if (g->method == WB_KRIGING) {
        wb_kriging_values(&g->kriging, work, w, a->displacement, a->error);
        a->coverage = is_beyond(g, w) ? WB_OUTSIDE : WB_COVERED;
    } else if (g->method == WB_LINEAR) {
        by_linear(g, work, w, a);
    } else if (g->method == WB_NEAREST) {
        by_nearest(g, work, w, a);
    } else {
        by_griddata(g, work, w, a);
    }
    judge(g, w, tolerance, a);
    if (a->coverage == WB_COVERED || (row = find_row(g, w)) < 0) return;
    if (tell_row(g, row, w, tolerance, a)) a->coverage = WB_COVERED, a->by_row = 1;
}

/* What the mesh lacks by an answer's tangent, T D u; 0 where that is not known. */
static int lacking_of(const wb_table *t, wb_workspace *work, const double w[6], const wb_answer *a,
                      double lacking[6]) {
    double tangent[36], pushed[6] = {0}, size = 0;
    wb_derivative_at(t, work, w, a, tangent);
    for (int k = 0; k < 6; k++)
        for (int q = 0; q < 6; q++) pushed[q] += t->stiffer[6 * q + k] * a->displacement[k];
    for (int k = 0; k < 36; k++) size += fabs(tangent[k]);
    if (!(size > 0)) return 0; /* a method without tangents, or none is known */
    for (int q = 0; q < 6; q++) {
        lacking[q] = 0;
        for (int k = 0; k < 6; k++) lacking[q] += tangent[6 * q + k] * pushed[k];
        if (!isfinite(lacking[q])) return 0;
    }
    return 1;
}

static int is_beyond_any(const wb_table *t, const double w[6]) {
    for (int i = 0; i < t->groups; i++)
        if (is_beyond(&t->group[i], w)) return 1;
    return 0;
}

/* `SolverError.widened`: what the solver of the rows may be wrong by itself. */
static void widen(const wb_table *t, wb_workspace *work, const double w[6], wb_answer *a) {
    double most = 0, lacking[6];
    int asks = *t->asks > 1 || (*t->asks > 0 && a->by_row && is_beyond_any(t, w));
    int told = asks && lacking_of(t, work, w, a, lacking);
    for (int k = 0; k < 6; k++) most = larger(fabs(w[k]) * t->one_over[k], most);
    for (int q = 0; q < 6; q++) {
        double small = 0;
        for (int k = 0; k < 6; k++) small += t->mesh[6 * q + k] * fabs(w[k]);
        a->error[q] += small;
        a->error[q] += told ? larger(fabs(lacking[q]) - small, 0) : t->bends[q] * (most * most);
    }
}

/* `within_tolerance`: what is said of the bar that is told, the solver's share included. */
static int within(const wb_table *t, const double tolerance[2], const double error[6]) {
    int held = -1;
    if (!(t->limit[0] > 0)) return -1; /* a part of the bars is not known */
    for (int q = 0; q < 6; q++) {
        double most = tolerance[q / 3] > 0 ? tolerance[q / 3] : t->limit[1 + q / 3];
        if (isnan(most)) return -1; /* no tolerance */
        if (isnan(error[q])) continue; /* nobody has measured it */
        if (!(error[q] <= most)) return 0;
        held = 1;
    }
    return held;
}

/* `Surrogate.batch`, or `MissingOutputs.batch` where several groups tell the outputs. */
void wb_answer_at(const wb_table *table, wb_workspace *work, const double wrench[6],
                  const double tolerance[2], wb_answer *answer) {
    double w[6];
    int worst = -1;
    for (int k = 0; k < 6; k++) w[k] = wrench[k] + 0.0; /* no negative zeros */
    for (int q = 0; q < 6; q++) answer->displacement[q] = answer->error[q] = NAN;
    for (int i = 0; i < table->groups; i++) {
        const wb_group *g = &table->group[i];
        wb_answer own;
        answer_of(g, work, w, tolerance, &own);
        for (int q = 0; q < 6; q++)
            if (g->outputs[q])
                answer->displacement[q] = own.displacement[q], answer->error[q] = own.error[q];
        /* An answer is a row's only if all its outputs are. */
        int rank = 2 * own.coverage + !own.by_row;
        if (rank > worst) worst = rank, answer->coverage = own.coverage, answer->by_row = own.by_row;
    }
    widen(table, work, w, answer);
    answer->within = within(table, tolerance, answer->error);
}

static void slopes_of(const wb_group *g, wb_workspace *work, const double w[6], double out[36]) {
    if (g->method == WB_KRIGING) wb_kriging_derivative(&g->kriging, work, w, out);
    else if (g->method == WB_LINEAR) memcpy(out, g->fit.matrix, 36 * sizeof(double));
    else if (g->method == WB_NEAREST) memset(out, 0, 36 * sizeof(double));
    else wb_compose_derivative(&g->composition, w, g->method == WB_TANGENT, out);
}

/* The tangent of the row at or beside a wrench; NaN if it has none. */
static void tangent_of(const wb_group *g, const double w[6], double out[36]) {
    int row = find_row(g, w), place = row < 0 ? -1 : g->row_tangent[row];
    for (int k = 0; k < 36; k++) out[k] = place < 0 ? NAN : g->tangent[36 * (int64_t)place + k];
}

/* `derivatives_at`: the interpolant's, or the tangent of the row that answers. */
void wb_derivative_at(const wb_table *table, wb_workspace *work, const double wrench[6],
                      const wb_answer *answer, double derivative[36]) {
    double w[6], own[36];
    for (int k = 0; k < 6; k++) w[k] = wrench[k] + 0.0;
    for (int k = 0; k < 36; k++) derivative[k] = NAN;
    for (int i = 0; i < table->groups; i++) {
        const wb_group *g = &table->group[i];
        if (answer->by_row) tangent_of(g, w, own);
        else slopes_of(g, work, w, own);
        for (int q = 0; q < 6; q++)
            if (g->outputs[q]) memcpy(derivative + 6 * q, own + 6 * q, 6 * sizeof(double));
    }
}
