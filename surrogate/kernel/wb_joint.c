/* The linearly implicit law of a joint: DESIGN section 11. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum { FREEDOMS = 6, MAX_SWEEPS = 30 }; /* of Jacobi's method: it converges in about six */
/* (omega dt)^2 up to which a mode is explicit: symplectic Euler is stable up to 4, and at 0.5 its
 * frequency is still within 2 %. */
static const double EXPLICIT = 0.5;
/* Of the largest diagonal: off-diagonal elements below it are rounding. */
static const double ROUNDING = 1e-17;

/* a = l l^T in place, the lower triangle; 0 if a is not positive definite. */
static int cholesky(double *a, int n) {
    for (int j = 0; j < n; j++) {
        double pivot = a[n * j + j];
        for (int k = 0; k < j; k++) pivot -= a[n * j + k] * a[n * j + k];
        if (!(pivot > 0) || !isfinite(pivot)) return 0;
        a[n * j + j] = sqrt(pivot);
        for (int i = j + 1; i < n; i++) {
            double sum = a[n * i + j];
            for (int k = 0; k < j; k++) sum -= a[n * i + k] * a[n * j + k];
            a[n * i + j] = sum / a[n * j + j];
            a[n * j + i] = 0;
        }
    }
    return 1;
}

/* Rotate rows and columns p and q of a symmetric matrix, and the columns of its modes. */
static void rotate(double *a, double *modes, int n, int p, int q) {
    double theta = (a[n * q + q] - a[n * p + p]) / (2 * a[n * p + q]);
    double t = (theta >= 0 ? 1 : -1) / (fabs(theta) + sqrt(theta * theta + 1));
    double c = 1 / sqrt(t * t + 1), s = t * c;
    for (int k = 0; k < n; k++) {
        double first = a[n * k + p], second = a[n * k + q];
        a[n * k + p] = c * first - s * second, a[n * k + q] = s * first + c * second;
    }
    for (int k = 0; k < n; k++) {
        double first = a[n * p + k], second = a[n * q + k];
        a[n * p + k] = c * first - s * second, a[n * q + k] = s * first + c * second;
        first = modes[n * k + p], second = modes[n * k + q];
        modes[n * k + p] = c * first - s * second, modes[n * k + q] = s * first + c * second;
    }
}

/* Eigenvalues on the diagonal of a, eigenvectors as columns: Jacobi's method (Golub and Van Loan
 * 2013, 8.5). */
static void diagonalise(double *a, double *modes, int n) {
    double largest = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) modes[n * i + j] = i == j;
    for (int i = 0; i < n; i++) largest = fmax(largest, fabs(a[n * i + i]));
    for (int sweep = 0; sweep < MAX_SWEEPS; sweep++) {
        int turned = 0;
        for (int p = 0; p < n; p++)
            for (int q = p + 1; q < n; q++)
                if (fabs(a[n * p + q]) > ROUNDING * largest) rotate(a, modes, n, p, q), turned = 1;
        if (!turned) return;
    }
}

/* b = l^T k l of a lower triangle. */
static void congruent(const double *l, const double *k, double *b, int n) {
    double kl[FREEDOMS * FREEDOMS];
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int m = j; m < n; m++) sum += k[n * i + m] * l[n * m + j];
            kl[n * i + j] = sum;
        }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            double sum = 0;
            for (int m = i; m < n; m++) sum += l[n * m + i] * kl[n * m + j];
            b[n * i + j] = sum;
        }
}

/* x = l^-T x, column by column. */
static void solve_transposed(const double *l, double *x, int n) {
    for (int j = 0; j < n; j++)
        for (int i = n - 1; i >= 0; i--) {
            for (int k = i + 1; k < n; k++) x[n * i + j] -= l[n * k + i] * x[n * k + j];
            x[n * i + j] /= l[n * i + i];
        }
}

/* wb_joint_rate, and the squares of the modes' frequencies (n). */
static int rate_of(int n, const double *stiffness, const double *inverse_mass, double dt,
                   double damping, double *rate, double *squares) {
    double l[FREEDOMS * FREEDOMS], b[FREEDOMS * FREEDOMS], modes[FREEDOMS * FREEDOMS];
    if (n < 1 || n > FREEDOMS) return WB_NOT_SQUARE;
    for (int i = 0; i < n * n; i++)
        if (!isfinite(stiffness[i]) || !isfinite(inverse_mass[i])) return WB_NOT_FINITE;
    memcpy(l, inverse_mass, (size_t)(n * n) * sizeof(double));
    if (!cholesky(l, n)) return WB_SINGULAR;
    congruent(l, stiffness, b, n);
    diagonalise(b, modes, n);
    solve_transposed(l, modes, n);
    memset(rate, 0, (size_t)(n * n) * sizeof(double));
    for (int mode = 0; mode < n; mode++) {
        double square = fmax(b[n * mode + mode], 0.0); /* rounding, or a part that buckles */
        squares[mode] = square;
        double step = square * dt * dt;
        double implicit = step > EXPLICIT ? 1 - EXPLICIT / step : 0.0;
        double rate_of_mode = dt * implicit * square + 2 * damping * sqrt(square);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++)
                rate[n * i + j] += rate_of_mode * modes[n * i + mode] * modes[n * j + mode];
    }
    return WB_OK;
}

int wb_joint_rate(int n, const double *stiffness, const double *inverse_mass, double dt,
                  double damping, double *rate) {
    double squares[FREEDOMS];
    return rate_of(n, stiffness, inverse_mass, dt, damping, rate, squares);
}

/* Of a table: the limit of its rotations, rad. */
static const double LARGEST_TURN = 20.0 * 3.14159265358979323846 / 180.0;
/* Beyond, no simulator makes the step: MAX_RANGES of joint.py. */
static const double MAX_RANGES = 2.0;
/* Of the range: changes of the boundary point below it are rounding. */
static const double CLOSE = 1e-9;
/* rad: below it 1/12 is right to 1e-9, and times the angle's square to rounding. */
static const double SMALL_ANGLE = 1e-3;
enum { TOWARDS_BOUNDARY = 8 }; /* steps to the boundary point; each gains some digits */

/* The largest errors of all steps. */
typedef struct {
    double value[FREEDOMS], step[FREEDOMS]; /* in which step it was, from 1 on; 0: never known */
    double time[FREEDOMS]; /* of the step's beginning, s */
} largest;

/* What a joint keeps behind the end of its last search: whether there was one, its loads (n),
 * displacement (m) and stiffness (n, m). */
typedef struct {
    double steps, covered, time; /* numbers of steps, and the sum of all, s */
    largest pose_error, wrench_error;
    double stored; /* J: the work of the wrenches at the poses, by trapezoids */
    double still[FREEDOMS], displacement[FREEDOMS]; /* of the last pose */
} history;

/* What a joint's step works with. */
typedef struct {
    const wb_table *t;
    const wb_joint *o;
    wb_options answer;
    int count, free[FREEDOMS];
    void *scratch;
    double *memory, *loads, *moved, *near;
    history *past;
} search;

size_t wb_joint_memory(const wb_table *t) {
    return 1 + (size_t)(t->inputs + t->outputs + t->inputs * t->outputs) +
           sizeof(history) / sizeof(double);
}

static void loads_of(const search *s, const double *wrench, double *loads) {
    for (int k = 0; k < s->t->inputs; k++)
        loads[k] = k < s->t->outputs || !s->o->inputs ? 0.0 : s->o->inputs[k];
    for (int k = 0; k < FREEDOMS; k++) loads[s->o->first + k] = wrench[k];
}

/* How far out loads are, in half widths of the range; 1 at its boundary. */
static double ranges_of(const wb_table *t, const double *loads) {
    double most = -INFINITY;
    for (int k = 0; k < t->inputs; k++)
        most = fmax(most, fmax(loads[k] - t->ends[t->inputs + k], t->ends[k] - loads[k]) / t->scale[k]);
    return 1.0 + most;
}

/* Loads on the boundary of the range, those that turn the part by 20 degrees at most. */
static void to_edge(const search *s, const double *loads, double turn, double *edge) {
    double wrench[FREEDOMS];
    for (int k = 0; k < FREEDOMS; k++) wrench[k] = loads[s->o->first + k] / fmax(turn, 1.0);
    loads_of(s, wrench, edge);
    for (int k = 0; k < s->t->inputs; k++)
        edge[k] = fmin(fmax(edge[k], s->t->ends[k]), s->t->ends[s->t->inputs + k]);
}

/* The wrench of a displacement beyond the range, linearly from the boundary in the same ratio. */
static int beyond(search *s, double *loads, const double *moved, double turn, double *stiffness) {
    const wb_table *t = s->t;
    int n = t->inputs, count = s->count, first = s->o->first;
    double edge[WB_MAX], before[WB_MAX], slopes[WB_MAX * WB_MAX], wrench[FREEDOMS];
    double matrix[FREEDOMS * FREEDOMS], unit[FREEDOMS * FREEDOMS];
    wb_reply reply;
    s->memory[0] = 0.0;
    to_edge(s, loads, turn, edge);
    for (int step = 0; step < TOWARDS_BOUNDARY; step++) {
        if (wb_answer(t, &s->answer, edge, &reply, s->scratch) ||
            wb_derivative(t, &s->answer, edge, slopes, s->scratch))
            return WB_SINGULAR;
        for (int i = 0; i < count; i++)
            for (int j = 0; j < count; j++) {
                matrix[count * i + j] = slopes[n * (first + s->free[i]) + first + s->free[j]];
                unit[count * i + j] = i == j;
            }
        if (!wb_eliminate(matrix, unit, count, count)) return WB_SINGULAR;
        memset(stiffness, 0, FREEDOMS * FREEDOMS * sizeof(double));
        for (int i = 0; i < count; i++)
            for (int j = 0; j < count; j++)
                stiffness[FREEDOMS * s->free[i] + s->free[j]] = unit[count * i + j];
        for (int i = 0; i < FREEDOMS; i++) {
            wrench[i] = edge[first + i];
            for (int j = 0; j < FREEDOMS; j++)
                wrench[i] += stiffness[FREEDOMS * i + j] * (moved[j] - reply.outputs[first + j]);
        }
        loads_of(s, wrench, loads);
        memcpy(before, edge, (size_t)n * sizeof(double));
        to_edge(s, loads, turn, edge);
        double change = 0;
        for (int k = 0; k < n; k++) change = fmax(change, fabs(edge[k] - before[k]) / t->scale[k]);
        if (change <= CLOSE) break;
    }
    return WB_OK;
}

/* The loads of a displacement, the stiffness by the rotation vector, and how far out it is. */
static int find(search *s, const double *moved, double *loads, double *stiffness, double *ranges) {
    const wb_table *t = s->t;
    int m = t->outputs, first = s->o->first, wrong;
    double target[WB_MAX] = {0}, slopes[WB_MAX * WB_MAX], none[FREEDOMS] = {0};
    double turn = sqrt(moved[3] * moved[3] + moved[4] * moved[4] + moved[5] * moved[5]) / LARGEST_TURN;
    size_t size = (size_t)(t->inputs * m) * sizeof(double);
    memcpy(target + first, moved, FREEDOMS * sizeof(double));
    loads_of(s, none, loads);
    memset(slopes, 0, size);
    if (s->memory[0] != 0.0) {
        for (int i = 0; i < m; i++) {
            loads[i] = s->loads[i];
            for (int q = 0; q < m; q++) loads[i] += s->near[m * i + q] * (target[q] - s->moved[q]);
        }
        memcpy(slopes, s->near, size);
    }
    wrong = wb_inverse(t, &s->answer, target, loads, slopes, s->scratch);
    if (wrong) loads_of(s, s->past->still, loads); /* no such wrench: far beyond the range */
    *ranges = fmax(ranges_of(t, loads), turn);
    if (wrong || *ranges > 1.0) {
        wrong = beyond(s, loads, moved, turn, stiffness);
        *ranges = fmax(ranges_of(t, loads), turn);
        return wrong;
    }
    s->memory[0] = 1.0;
    memcpy(s->loads, loads, (size_t)t->inputs * sizeof(double));
    memcpy(s->moved, target, (size_t)m * sizeof(double));
    memcpy(s->near, slopes, size);
    for (int i = 0; i < FREEDOMS; i++)
        memcpy(stiffness + FREEDOMS * i, slopes + m * (first + i) + first, FREEDOMS * sizeof(double));
    return WB_OK;
}

/* The displacement of a pose, and the matrix from the axes of the spin to the frame's. */
static int displacement_of(const wb_joint *o, const double *pose, double *moved, double *spin) {
    double q[4], along[3], length = 0, size;
    for (int i = 0; i < 7; i++)
        if (!isfinite(pose[i])) return WB_NOT_FINITE;
    for (int i = 0; i < 4; i++) length += pose[3 + i] * pose[3 + i];
    if (!(length > 0)) return WB_NOT_FINITE;
    length = (pose[3] < 0 ? -1 : 1) * sqrt(length);
    for (int i = 0; i < 4; i++) q[i] = pose[3 + i] / length;
    for (int j = 0; j < 3; j++) {
        along[j] = o->axes ? 0.0 : q[1 + j];
        for (int i = 0; i < 3 && o->axes; i++) along[j] += q[1 + i] * o->axes[3 * i + j];
    }
    size = sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
    for (int i = 0; i < 3; i++) {
        moved[i] = pose[i];
        moved[3 + i] = size > 0 ? along[i] * (2 * atan2(size, q[0]) / size) : 0.0;
    }
    double x = along[0], y = along[1], z = along[2], w = q[0];
    double turned[9] = {1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
                        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
                        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)};
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            spin[3 * i + j] = o->axes ? 0.0 : i == j;
            for (int k = 0; k < 3 && o->axes; k++)
                spin[3 * i + j] += turned[3 * i + k] * o->axes[3 * j + k];
        }
    return WB_OK;
}

/* The change of a rotation vector with the angle about fixed axes, (3, 3):
 * T^-1 = I - [r]/2 + (1/a^2 - (1 + cos a)/(2 a sin a)) [r]^2, a = |r| (Iserles et al. 2000); the
 * last factor is 1/12 for small angles. */
static void vector_per_spin(const double *r, double *out) {
    double x = r[0], y = r[1], z = r[2], angle = sqrt(x * x + y * y + z * z), f = 1.0 / 12.0;
    if (angle > SMALL_ANGLE) f = 1 / (angle * angle) - (1 + cos(angle)) / (2 * angle * sin(angle));
    double rows[9] = {1 - f * (y * y + z * z), 0.5 * z + f * x * y,      -0.5 * y + f * x * z,
                      -0.5 * z + f * x * y,    1 - f * (x * x + z * z), 0.5 * x + f * y * z,
                      0.5 * y + f * x * z,     -0.5 * x + f * y * z,    1 - f * (x * x + y * y)};
    memcpy(out, rows, sizeof rows);
}

/* The stiffness by the angle about fixed axes; what turning the moment adds is antisymmetric, does no
 * work and is left out. Returns whether that of the free freedoms, by the vector, is positive. */
static int symmetric(const search *s, const double *by_vector, const double *r, double *out) {
    double turn[9], full[FREEDOMS * FREEDOMS], square[FREEDOMS * FREEDOMS];
    vector_per_spin(r, turn);
    for (int i = 0; i < FREEDOMS; i++)
        for (int j = 0; j < FREEDOMS; j++) {
            full[FREEDOMS * i + j] = j < 3 ? by_vector[FREEDOMS * i + j] : 0.0;
            for (int k = 0; k < 3 && j >= 3; k++)
                full[FREEDOMS * i + j] += by_vector[FREEDOMS * i + 3 + k] * turn[3 * k + j - 3];
        }
    for (int i = 0; i < FREEDOMS; i++)
        for (int j = 0; j < FREEDOMS; j++)
            out[FREEDOMS * i + j] = 0.5 * (full[FREEDOMS * i + j] + full[FREEDOMS * j + i]);
    for (int i = 0; i < s->count; i++)
        for (int j = 0; j < s->count; j++)
            square[s->count * i + j] = by_vector[FREEDOMS * s->free[i] + s->free[j]] +
                                       by_vector[FREEDOMS * s->free[j] + s->free[i]];
    return cholesky(square, s->count);
}

/* v (6) with its rotational part turned: by the matrix, or by its transposed. */
static void turn_part(const double *matrix, int transposed, const double *v, double *out) {
    for (int i = 0; i < 3; i++) {
        out[i] = v[i], out[3 + i] = 0;
        for (int k = 0; k < 3; k++)
            out[3 + i] += matrix[transposed ? 3 * k + i : 3 * i + k] * v[3 + k];
    }
}

/* C in the axes of the spin, and the wrench of the step. */
static int advance(const search *s, const double *velocity, const double *inverse_mass,
                   wb_joint_reply *reply) {
    int n = s->count, size = FREEDOMS * FREEDOMS;
    double half[FREEDOMS * FREEDOMS], turned[FREEDOMS * FREEDOMS], stiffness[FREEDOMS * FREEDOMS];
    double mass[FREEDOMS * FREEDOMS], rate[FREEDOMS * FREEDOMS], matrix[FREEDOMS * FREEDOMS];
    double right[FREEDOMS], wrench[FREEDOMS] = {0};
    for (int i = 0; i < FREEDOMS; i++) /* B^T K B: K is symmetric, and B turns the spins */
        turn_part(reply->spin, 1, reply->stiffness + FREEDOMS * i, half + FREEDOMS * i);
    for (int j = 0; j < FREEDOMS; j++) {
        double column[FREEDOMS];
        for (int k = 0; k < FREEDOMS; k++) column[k] = half[FREEDOMS * k + j];
        turn_part(reply->spin, 1, column, turned + FREEDOMS * j);
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) {
            stiffness[n * i + j] = turned[FREEDOMS * s->free[i] + s->free[j]];
            mass[n * i + j] = inverse_mass[FREEDOMS * s->free[i] + s->free[j]];
        }
    double squares[FREEDOMS];
    int wrong = rate_of(n, stiffness, mass, s->o->dt, s->o->damping, rate, squares);
    for (int k = 0; k < size; k++) reply->rate[k] = 0.0;
    if (wrong) return wrong == WB_SINGULAR ? WB_NO_MASS : wrong;
    for (int i = 0; i < n; i++) {
        reply->frequency[s->free[i]] = sqrt(squares[i]);
        for (int j = 0; j < n; j++) reply->rate[FREEDOMS * s->free[i] + s->free[j]] = rate[n * i + j];
    }
    if (!velocity) return WB_OK;
    for (int i = 0; i < n; i++) {
        right[i] = reply->force[s->free[i]];
        for (int j = 0; j < n; j++) right[i] += rate[n * i + j] * velocity[s->free[j]];
        for (int j = 0; j < n; j++) {
            matrix[n * i + j] = i == j;
            for (int k = 0; k < n; k++)
                matrix[n * i + j] += s->o->dt * rate[n * i + k] * mass[n * k + j];
        }
    }
    for (int i = 0; i < n; i++)
        if (!isfinite(right[i])) return WB_NOT_FINITE;
    if (!wb_eliminate(matrix, right, n, 1)) return WB_NO_MASS;
    for (int i = 0; i < n; i++) wrench[s->free[i]] = right[i];
    turn_part(reply->spin, 0, wrench, reply->wrench);
    return WB_OK;
}

/* Coverage and errors of the wrench at the pose. */
static void judge(const search *s, const double *loads, const double *stiffness, wb_joint_reply *reply) {
    wb_reply answer;
    reply->coverage = WB_OUTSIDE;
    if (reply->ranges > 1.0 || wb_answer(s->t, &s->answer, loads, &answer, s->scratch)) return;
    reply->coverage = answer.coverage;
    for (int i = 0; i < FREEDOMS; i++) {
        reply->pose_error[i] = answer.error[s->o->first + i];
        reply->wrench_error[i] = 0;
    }
    for (int i = 0; i < s->count; i++)
        for (int j = 0; j < s->count; j++)
            reply->wrench_error[s->free[i]] += fabs(stiffness[FREEDOMS * s->free[i] + s->free[j]]) *
                                               answer.error[s->o->first + s->free[j]];
}

static void keep_largest(const double *error, const history *h, largest *kept) {
    for (int i = 0; i < FREEDOMS; i++)
        if (error[i] > kept->value[i] || (kept->step[i] == 0 && !isnan(error[i])))
            kept->value[i] = error[i], kept->step[i] = h->steps, kept->time[i] = h->time;
}

/* Go on with the history: errors, and the energy stored since the last pose. */
static void remember(history *h, const wb_joint_reply *reply, double dt) {
    double change[FREEDOMS], middle[3], turn[9];
    for (int i = 0; i < FREEDOMS; i++) change[i] = reply->displacement[i] - h->displacement[i];
    for (int i = 0; i < 3; i++) middle[i] = 0.5 * (reply->displacement[3 + i] + h->displacement[3 + i]);
    vector_per_spin(middle, turn);
    if (h->steps > 0 && wb_eliminate(turn, change + 3, 3, 1))
        for (int i = 0; i < FREEDOMS; i++)
            h->stored += 0.5 * (h->still[i] + reply->still[i]) * change[i];
    h->steps++;
    keep_largest(reply->pose_error, h, &h->pose_error);
    keep_largest(reply->wrench_error, h, &h->wrench_error);
    h->covered += reply->coverage == WB_COVERED;
    h->time += dt;
    memcpy(h->still, reply->still, sizeof h->still);
    memcpy(h->displacement, reply->displacement, sizeof h->displacement);
}

static void step(search *s, const double *pose, const double *velocity, const double *inverse_mass,
                 wb_joint_reply *reply) {
    double loads[WB_MAX], by_vector[FREEDOMS * FREEDOMS], *numbers = (double *)reply;
    for (size_t k = 0; k < offsetof(wb_joint_reply, coverage) / sizeof(double); k++) numbers[k] = NAN;
    memset(reply->frequency, 0, sizeof reply->frequency);
    reply->coverage = -1;
    if ((reply->status = displacement_of(s->o, pose, reply->displacement, reply->spin))) return;
    if ((reply->status = find(s, reply->displacement, loads, by_vector, &reply->ranges))) return;
    memcpy(reply->still, loads + s->o->first, sizeof reply->still);
    memcpy(reply->wrench, reply->still, sizeof reply->wrench);
    turn_part(reply->spin, 1, reply->wrench, reply->force);
    int positive = symmetric(s, by_vector, reply->displacement + 3, reply->stiffness);
    if (s->o->errors) judge(s, loads, by_vector, reply);
    if (inverse_mass) reply->status = advance(s, velocity, inverse_mass, reply);
    if (!reply->status && inverse_mass && reply->ranges <= MAX_RANGES) remember(s->past, reply, s->o->dt);
    if (!reply->status && !positive) reply->status = WB_INDEFINITE;
}

typedef struct {
    const wb_table *t;
    const wb_joint *o;
    size_t n;
    const double *poses, *velocities, *inverse_masses;
    double *memory;
    wb_joint_reply *replies;
    void *scratch;
} joints;

static int run(void *job, size_t first, size_t steps) {
    const joints *all = job;
    const wb_table *t = all->t;
    search s = {t, all->o, all->o->answer, 0, {0}, all->scratch, NULL, NULL, NULL, NULL, NULL};
    if (!s.scratch && !(s.scratch = malloc(wb_scratch(t)))) return WB_NO_MEMORY;
    for (int k = 0; k < FREEDOMS; k++)
        if (!t->locked[all->o->first + k]) s.free[s.count++] = k;
    for (size_t i = first; i < all->n; i += steps) {
        s.memory = all->memory + i * wb_joint_memory(t);
        s.loads = s.memory + 1, s.moved = s.loads + t->inputs, s.near = s.moved + t->outputs;
        s.past = (history *)(s.near + t->inputs * t->outputs);
        step(&s, all->poses + 7 * i, all->velocities ? all->velocities + FREEDOMS * i : NULL,
             all->inverse_masses ? all->inverse_masses + FREEDOMS * FREEDOMS * i : NULL,
             all->replies + i);
    }
    if (!all->scratch) free(s.scratch);
    return WB_OK;
}

int wb_joint_step(const wb_table *t, const wb_joint *joint, size_t n, const double *poses,
                  const double *velocities, const double *inverse_masses, double *memory,
                  wb_joint_reply *replies, int threads, void *scratch) {
    joints all = {t, joint, n, poses, velocities, inverse_masses, memory, replies,
                  threads > 1 ? NULL : scratch};
    if (joint->first < 0 || joint->first + FREEDOMS > t->outputs || t->inputs < t->outputs)
        return WB_NOT_SQUARE;
    return n ? wb_share(run, &all, n, threads) : WB_OK;
}
