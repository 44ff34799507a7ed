/* The linearly implicit law of a joint: DESIGN section 11. MIT license. */
#include "wb_internal.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum { SIX = 6, MAX_SWEEPS = 30 }; /* of Jacobi's method: it converges in about six */
/* Of a joint: a table's index of rows takes 24 inputs (surrogate/table/merging.py). */
enum { MAX_INTERFACES = 4, FREEDOMS = SIX * MAX_INTERFACES };
/* (omega dt)^2 up to which a mode is explicit: symplectic Euler is stable up to 4, and at 0.5 its
 * frequency is still within 2 %. */
static const double EXPLICIT = 0.5;
static const double KEPT = 9.8696; /* of an undamped part's modes: pi^2, two steps a period */
/* Of the largest diagonal: off-diagonal elements below it are rounding. */
static const double ROUNDING = 1e-17;
/* The square of the relative asymmetry of an inverse mass: single precision is better than 1e-3, a
 * matrix of mixed frames or half of one is not. */
static const double ASYMMETRY = 1e-6;

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

static int is_symmetric(const double *a, int n) {
    int wrong = 0;
    for (int i = 0; i < n; i++)
        for (int j = 0; j < i; j++) {
            double difference = a[n * i + j] - a[n * j + i];
            wrong |= difference * difference > ASYMMETRY * fabs(a[n * i + i] * a[n * j + j]);
        }
    return !wrong;
}

/* wb_joint_rate, and the squares of the modes' frequencies (n). With `kept` (n, n), the part of the
 * rate by the acceleration, modes up to KEPT keep their energy: Newmark's method, beta = 1/4. */
static int rate_of(int n, const double *stiffness, const double *inverse_mass, double dt,
                   double damping, double *rate, double *kept, double *squares) {
    double l[FREEDOMS * FREEDOMS], b[FREEDOMS * FREEDOMS], modes[FREEDOMS * FREEDOMS];
    if (n < 1 || n > FREEDOMS) return WB_NOT_SQUARE;
    for (int i = 0; i < n * n; i++)
        if (!isfinite(stiffness[i]) || !isfinite(inverse_mass[i])) return WB_NOT_FINITE;
    memcpy(l, inverse_mass, (size_t)(n * n) * sizeof(double));
    if (!is_symmetric(l, n) || !cholesky(l, n)) return WB_SINGULAR;
    congruent(l, stiffness, b, n);
    diagonalise(b, modes, n);
    solve_transposed(l, modes, n);
    memset(rate, 0, (size_t)(n * n) * sizeof(double));
    for (int mode = 0; mode < n; mode++) {
        double square = fmax(b[n * mode + mode], 0.0); /* rounding, or a part that buckles */
        squares[mode] = square;
        double step = square * dt * dt;
        double end = kept ? KEPT : EXPLICIT, implicit = step > end ? 1 - end / step : 0.0;
        double beta = kept ? 0.25 * (fmin(1.0, step / EXPLICIT) - implicit) : 0.0;
        double rate_of_mode = dt * (implicit + beta) * square + 2 * damping * sqrt(square);
        for (int i = 0; i < n; i++)
            for (int j = 0; j < n; j++) {
                double both = modes[n * i + mode] * modes[n * j + mode];
                rate[n * i + j] += rate_of_mode * both;
                if (kept) kept[n * i + j] += dt * beta * square * both;
            }
    }
    return WB_OK;
}

int wb_joint_rate(int n, const double *stiffness, const double *inverse_mass, double dt,
                  double damping, double *rate) {
    double squares[FREEDOMS];
    return rate_of(n, stiffness, inverse_mass, dt, damping, rate, NULL, squares);
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

/* The largest errors of all steps, (n): in which step they were, from 1 on; 0: never known. And the
 * time of the step's beginning, s. */
typedef struct {
    double *value, *step, *time;
} largest;

/* What a joint of k interfaces, n = 6 k freedoms, keeps behind the end of its last search: whether
 * there was one, its loads (inputs), displacement (outputs) and stiffness (inputs, outputs). */
typedef struct {
    double *steps, *covered, *time; /* numbers of steps, and the sum of all, s */
    largest pose_error, wrench_error;
    double *stored; /* J: the work of the wrenches at the poses, by trapezoids */
    double *still, *displacement; /* (n) of the last pose */
    double *covered_at; /* (k) numbers of steps; of several interfaces alone */
} history;

/* Where the members of a joint's reply are. */
typedef struct {
    double *wrench, *displacement, *still, *force, *rate, *stiffness, *spin, *frequency, *pose_error,
        *wrench_error, *ranges;
    int32_t *coverage, *status;
} members;

/* What a joint's step works with. */
typedef struct {
    const wb_table *t;
    const wb_joint *o;
    wb_options answer;
    int interfaces, n, place[FREEDOMS]; /* of its loads among those of the table */
    int count, free[FREEDOMS];
    void *scratch;
    double *memory, *loads, *moved, *near;
    history past;
} search;

static double *next(double **at, int count) { return (*at += count) - count; }

static largest largest_at(double **at, int n) {
    largest l;
    l.value = next(at, n), l.step = next(at, n), l.time = next(at, n);
    return l;
}

/* The history of n freedoms at a place. */
static void history_at(double *at, int n, history *h) {
    h->steps = next(&at, 1), h->covered = next(&at, 1), h->time = next(&at, 1);
    h->pose_error = largest_at(&at, n), h->wrench_error = largest_at(&at, n);
    h->stored = next(&at, 1), h->still = next(&at, n), h->displacement = next(&at, n);
    h->covered_at = at;
}

/* The members of a reply of n freedoms, as wb_joint_reply has those of six. */
static void members_at(double *at, int n, members *r) {
    int k = n / SIX;
    r->wrench = next(&at, n), r->displacement = next(&at, n);
    r->still = next(&at, n), r->force = next(&at, n);
    r->rate = next(&at, n * n), r->stiffness = next(&at, n * n), r->spin = next(&at, 9 * k);
    r->frequency = next(&at, n), r->pose_error = next(&at, n), r->wrench_error = next(&at, n);
    r->ranges = next(&at, 1);
    r->coverage = (int32_t *)at, r->status = r->coverage + k;
}

/* The places of the loads of all interfaces that move, and their number. */
static int places_of(const wb_table *t, int *place) {
    int n = 0;
    if (t->inputs < t->outputs) return 0;
    for (int first = 0; first + SIX <= t->outputs; first += SIX) {
        int moves = 0;
        for (int k = first; k < first + SIX; k++) moves |= !t->locked[k];
        if (moves)
            for (int k = first; k < first + SIX; k++, n++)
                if (n < FREEDOMS) place[n] = k;
    }
    return n;
}

int wb_joint_interfaces(const wb_table *t) {
    int place[FREEDOMS];
    return places_of(t, place) / SIX;
}

static size_t memory_of(const wb_table *t, int k) {
    int past = 4 + 8 * SIX * k + (k > 1 ? k : 0);
    return (size_t)(1 + t->inputs + t->outputs + t->inputs * t->outputs + past);
}

static size_t reply_size(int k) {
    size_t doubles = (size_t)(7 * SIX * k + 2 * SIX * SIX * k * k + 9 * k + 1);
    return doubles * sizeof(double) + (size_t)(k / 2 + 1) * 2 * sizeof(int32_t);
}

size_t wb_joint_memory(const wb_table *t) { return memory_of(t, wb_joint_interfaces(t)); }

size_t wb_joint_reply_size(const wb_table *t) { return reply_size(wb_joint_interfaces(t)); }

static void loads_of(const search *s, const double *wrench, double *loads) {
    for (int k = 0; k < s->t->inputs; k++)
        loads[k] = k < s->t->outputs || !s->o->inputs ? 0.0 : s->o->inputs[k];
    for (int k = 0; k < s->n; k++) loads[s->place[k]] = wrench[k];
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
    for (int k = 0; k < s->n; k++) wrench[k] = loads[s->place[k]] / fmax(turn, 1.0);
    loads_of(s, wrench, edge);
    for (int k = 0; k < s->t->inputs; k++)
        edge[k] = fmin(fmax(edge[k], s->t->ends[k]), s->t->ends[s->t->inputs + k]);
}

/* The wrench of a displacement beyond the range, linearly from the boundary in the same ratio. */
static int beyond(search *s, double *loads, const double *moved, double turn, double *stiffness) {
    const wb_table *t = s->t;
    int inputs = t->inputs, n = s->n, count = s->count;
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
                matrix[count * i + j] = slopes[inputs * s->place[s->free[i]] + s->place[s->free[j]]];
                unit[count * i + j] = i == j;
            }
        if (!wb_eliminate(matrix, unit, count, count)) return WB_SINGULAR;
        memset(stiffness, 0, (size_t)(n * n) * sizeof(double));
        for (int i = 0; i < count; i++)
            for (int j = 0; j < count; j++)
                stiffness[n * s->free[i] + s->free[j]] = unit[count * i + j];
        for (int i = 0; i < n; i++) {
            wrench[i] = edge[s->place[i]];
            for (int j = 0; j < n; j++)
                wrench[i] += stiffness[n * i + j] * (moved[j] - reply.outputs[s->place[j]]);
        }
        loads_of(s, wrench, loads);
        memcpy(before, edge, (size_t)inputs * sizeof(double));
        to_edge(s, loads, turn, edge);
        double change = 0;
        for (int k = 0; k < inputs; k++) change = fmax(change, fabs(edge[k] - before[k]) / t->scale[k]);
        if (change <= CLOSE) break;
    }
    return WB_OK;
}

/* The loads of a displacement, the stiffness by the rotation vector, and how far out it is. */
static int find(search *s, const double *moved, double *loads, double *stiffness, double *ranges) {
    const wb_table *t = s->t;
    int m = t->outputs, n = s->n, wrong;
    double target[WB_MAX] = {0}, slopes[WB_MAX * WB_MAX], none[FREEDOMS] = {0}, turn = 0;
    for (const double *r = moved + 3; r < moved + n; r += SIX)
        turn = fmax(turn, sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) / LARGEST_TURN);
    size_t size = (size_t)(t->inputs * m) * sizeof(double);
    for (int i = 0; i < n; i++) target[s->place[i]] = moved[i];
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
    if (wrong) loads_of(s, s->past.still, loads); /* no such wrench: far beyond the range */
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
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) stiffness[n * i + j] = slopes[m * s->place[i] + s->place[j]];
    return WB_OK;
}

/* The displacement of an interface's pose, and the matrix from the axes of the spin to the frame's. */
static int displacement_of(const double *axes, const double *pose, double *moved, double *spin) {
    double q[4], along[3], length = 0, size;
    for (int i = 0; i < 7; i++)
        if (!isfinite(pose[i])) return WB_NOT_FINITE;
    for (int i = 0; i < 4; i++) length += pose[3 + i] * pose[3 + i];
    if (!(length > 0)) return WB_NOT_FINITE;
    length = (pose[3] < 0 ? -1 : 1) * sqrt(length);
    for (int i = 0; i < 4; i++) q[i] = pose[3 + i] / length;
    for (int j = 0; j < 3; j++) {
        along[j] = axes ? 0.0 : q[1 + j];
        if (axes)
            for (int i = 0; i < 3; i++) along[j] += q[1 + i] * axes[3 * i + j];
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
            spin[3 * i + j] = axes ? 0.0 : i == j;
            if (axes)
                for (int k = 0; k < 3; k++)
                    spin[3 * i + j] += turned[3 * i + k] * axes[3 * j + k];
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
static int symmetric(const search *s, const double *by_vector, const double *moved, double *out) {
    int n = s->n;
    double turn[9], full[FREEDOMS * FREEDOMS], square[FREEDOMS * FREEDOMS];
    for (int first = 0; first < n; first += SIX) {
        vector_per_spin(moved + first + 3, turn);
        for (int i = 0; i < n; i++) {
            const double *row = by_vector + n * i + first;
            for (int j = 0; j < SIX; j++) {
                double sum = j < 3 ? row[j] : 0.0;
                if (j >= 3)
                    for (int k = 0; k < 3; k++) sum += row[3 + k] * turn[3 * k + j - 3];
                full[n * i + first + j] = sum;
            }
        }
    }
    for (int i = 0; i < n; i++)
        for (int j = 0; j < n; j++) out[n * i + j] = 0.5 * (full[n * i + j] + full[n * j + i]);
    for (int i = 0; i < s->count; i++)
        for (int j = 0; j < s->count; j++)
            square[s->count * i + j] = by_vector[n * s->free[i] + s->free[j]] +
                                       by_vector[n * s->free[j] + s->free[i]];
    return cholesky(square, s->count);
}

/* v (n) with its rotational parts turned: each by its matrix, or by its transposed. */
static void turn_parts(const double *matrix, int transposed, const double *v, int n, double *out) {
    for (int first = 0; first < n; first += SIX, matrix += 9)
        for (int i = 0; i < 3; i++) {
            out[first + i] = v[first + i], out[first + 3 + i] = 0;
            for (int k = 0; k < 3; k++)
                out[first + 3 + i] += matrix[transposed ? 3 * k + i : 3 * i + k] * v[first + 3 + k];
        }
}

/* C in the axes of the spins, and the wrench of the step. */
static int advance(const search *s, const double *velocity, const double *inverse_mass,
                   const members *reply) {
    int n = s->n, count = s->count;
    double half[FREEDOMS * FREEDOMS], turned[FREEDOMS * FREEDOMS], stiffness[FREEDOMS * FREEDOMS];
    double mass[FREEDOMS * FREEDOMS], rate[FREEDOMS * FREEDOMS], matrix[FREEDOMS * FREEDOMS];
    double right[FREEDOMS], wrench[FREEDOMS] = {0}, squares[FREEDOMS];
    double kept[FREEDOMS * FREEDOMS] = {0};
    if (!(s->o->dt > 0 && s->o->damping >= 0 && isfinite(s->o->dt + s->o->damping)))
        return WB_NOT_FINITE;
    int keeps = s->o->law && s->o->damping == 0 && velocity && !isnan(velocity[s->free[0]]);
    for (int i = 0; i < n; i++) /* B^T K B: K is symmetric, and B turns the spins */
        turn_parts(reply->spin, 1, reply->stiffness + n * i, n, half + n * i);
    for (int j = 0; j < n; j++) {
        double column[FREEDOMS];
        for (int k = 0; k < n; k++) column[k] = half[n * k + j];
        turn_parts(reply->spin, 1, column, n, turned + n * j);
    }
    for (int i = 0; i < count; i++)
        for (int j = 0; j < count; j++) {
            stiffness[count * i + j] = turned[n * s->free[i] + s->free[j]];
            mass[count * i + j] = inverse_mass[n * s->free[i] + s->free[j]];
        }
    int wrong = rate_of(count, stiffness, mass, s->o->dt, s->o->damping, rate,
                        keeps ? kept : NULL, squares);
    for (int k = 0; k < n * n; k++) reply->rate[k] = 0.0;
    if (wrong) return wrong == WB_SINGULAR ? WB_NO_MASS : wrong;
    for (int i = 0; i < count; i++) {
        reply->frequency[s->free[i]] = sqrt(squares[i]);
        for (int j = 0; j < count; j++) {
            reply->rate[n * s->free[i] + s->free[j]] = rate[count * i + j];
            if (keeps) reply->force[s->free[i]] -= kept[count * i + j] * velocity[s->free[j]];
        }
    }
    if (!velocity || s->o->law) return WB_OK;
    for (int i = 0; i < count; i++) {
        right[i] = reply->force[s->free[i]];
        for (int j = 0; j < count; j++) right[i] += rate[count * i + j] * velocity[s->free[j]];
        for (int j = 0; j < count; j++) {
            matrix[count * i + j] = i == j;
            for (int k = 0; k < count; k++)
                matrix[count * i + j] += s->o->dt * rate[count * i + k] * mass[count * k + j];
        }
    }
    for (int i = 0; i < count; i++)
        if (!isfinite(right[i])) return WB_NOT_FINITE;
    if (!wb_eliminate(matrix, right, count, 1)) return WB_NO_MASS;
    for (int i = 0; i < count; i++) wrench[s->free[i]] = right[i];
    turn_parts(reply->spin, 0, wrench, n, reply->wrench);
    return WB_OK;
}

/* Whether the error of an output of an interface is above what its group allows, or not known. */
static int is_thin(const search *s, const wb_reply *answer, int interface) {
    for (int i = SIX * interface; i < SIX * (interface + 1); i++)
        for (int g = 0; g < s->t->groups; g++) {
            int q = s->place[i];
            if (!s->t->locked[q] && s->t->group[g].outputs[q] &&
                !(answer->interpolation[q] <= wb_allowed(&s->t->group[g], &s->answer, q)))
                return 1;
        }
    return 0;
}

/* Coverage, by interface, and errors of the wrench at the pose. */
static void judge(const search *s, const double *loads, const double *stiffness, const members *reply) {
    wb_reply answer;
    int any = 0;
    for (int k = 0; k < s->interfaces; k++) reply->coverage[k] = WB_OUTSIDE;
    if (*reply->ranges > 1.0 || wb_answer(s->t, &s->answer, loads, &answer, s->scratch)) return;
    for (int k = 0; k < s->interfaces; k++) { /* loads beyond the rows concern all of the part */
        int covers = s->interfaces > 1 && answer.coverage == WB_THIN && !is_thin(s, &answer, k);
        reply->coverage[k] = covers ? WB_COVERED : answer.coverage, any |= !covers;
    }
    if (!any)
        for (int k = 0; k < s->interfaces; k++) reply->coverage[k] = answer.coverage;
    for (int i = 0; i < s->n; i++) {
        reply->pose_error[i] = answer.error[s->place[i]];
        reply->wrench_error[i] = 0;
    }
    for (int i = 0; i < s->count; i++)
        for (int j = 0; j < s->count; j++)
            reply->wrench_error[s->free[i]] += fabs(stiffness[s->n * s->free[i] + s->free[j]]) *
                                               answer.error[s->place[s->free[j]]];
}

static void keep_largest(const double *error, int n, const history *h, const largest *kept) {
    for (int i = 0; i < n; i++)
        if (error[i] > kept->value[i] || (kept->step[i] == 0 && !isnan(error[i])))
            kept->value[i] = error[i], kept->step[i] = *h->steps, kept->time[i] = *h->time;
}

/* Go on with the history: errors, and the energy stored since the last pose. */
static void remember(const search *s, const members *reply) {
    const history *h = &s->past;
    int n = s->n, covered = 1;
    for (int first = 0; first < n; first += SIX) {
        const double *now = reply->displacement + first, *then = h->displacement + first;
        double change[SIX], middle[3], turn[9];
        for (int i = 0; i < SIX; i++) change[i] = now[i] - then[i];
        for (int i = 0; i < 3; i++) middle[i] = 0.5 * (now[3 + i] + then[3 + i]);
        vector_per_spin(middle, turn);
        if (*h->steps > 0 && wb_eliminate(turn, change + 3, 3, 1))
            for (int i = 0; i < SIX; i++)
                *h->stored += 0.5 * (h->still[first + i] + reply->still[first + i]) * change[i];
    }
    ++*h->steps;
    keep_largest(reply->pose_error, n, h, &h->pose_error);
    keep_largest(reply->wrench_error, n, h, &h->wrench_error);
    for (int k = 0; k < s->interfaces; k++) {
        if (s->interfaces > 1) h->covered_at[k] += reply->coverage[k] == WB_COVERED;
        covered &= reply->coverage[k] == WB_COVERED;
    }
    *h->covered += covered, *h->time += s->o->dt;
    memcpy(h->still, reply->still, (size_t)n * sizeof(double));
    memcpy(h->displacement, reply->displacement, (size_t)n * sizeof(double));
}

static void step(search *s, const double *pose, const double *velocity, const double *inverse_mass,
                 const members *reply) {
    double loads[WB_MAX], by_vector[FREEDOMS * FREEDOMS];
    int status = WB_OK, n = s->n;
    for (double *at = reply->wrench; at <= reply->ranges; at++) *at = NAN;
    memset(reply->frequency, 0, (size_t)n * sizeof(double));
    for (int k = 0; k < s->interfaces; k++) reply->coverage[k] = -1;
    for (int k = 0; k < s->interfaces && !status; k++)
        status = displacement_of(s->o->axes ? s->o->axes + 9 * k : NULL, pose + 7 * k,
                                 reply->displacement + SIX * k, reply->spin + 9 * k);
    if ((*reply->status = status)) return;
    if ((*reply->status = find(s, reply->displacement, loads, by_vector, reply->ranges))) return;
    for (int i = 0; i < n; i++) reply->still[i] = reply->wrench[i] = loads[s->place[i]];
    turn_parts(reply->spin, 1, reply->wrench, n, reply->force);
    int positive = symmetric(s, by_vector, reply->displacement, reply->stiffness);
    if (s->o->errors) judge(s, loads, by_vector, reply);
    if (inverse_mass) status = advance(s, velocity, inverse_mass, reply);
    for (int i = 0; status && i < n; i++) reply->wrench[i] = reply->force[i] = NAN;
    for (int i = 0; status && i < n * n; i++) reply->rate[i] = NAN;
    if (!status && inverse_mass && *reply->ranges <= MAX_RANGES) remember(s, reply);
    *reply->status = !status && !positive ? WB_INDEFINITE : status;
}

typedef struct {
    const wb_table *t;
    const wb_joint *o;
    size_t n;
    const double *poses, *velocities, *inverse_masses;
    double *memory;
    char *replies;
    void *scratch;
} joints;

static int run(void *job, size_t first, size_t steps) {
    const joints *all = job;
    const wb_table *t = all->t;
    search s;
    members reply;
    s.t = t, s.o = all->o, s.answer = all->o->answer, s.count = 0, s.scratch = all->scratch;
    if (!s.scratch && !(s.scratch = malloc(wb_scratch(t)))) return WB_NO_MEMORY;
    s.n = places_of(t, s.place), s.interfaces = s.n / SIX;
    size_t memory = memory_of(t, s.interfaces), size = reply_size(s.interfaces);
    for (int k = 0; k < s.n; k++)
        if (!t->locked[s.place[k]]) s.free[s.count++] = k;
    for (size_t i = first; i < all->n; i += steps) {
        s.memory = all->memory + i * memory;
        s.loads = s.memory + 1, s.moved = s.loads + t->inputs, s.near = s.moved + t->outputs;
        history_at(s.near + t->inputs * t->outputs, s.n, &s.past);
        members_at((double *)(all->replies + i * size), s.n, &reply);
        step(&s, all->poses + 7 * s.interfaces * i, all->velocities ? all->velocities + s.n * i : NULL,
             all->inverse_masses ? all->inverse_masses + s.n * s.n * i : NULL, &reply);
    }
    if (!all->scratch) free(s.scratch);
    return WB_OK;
}

int wb_joint_step(const wb_table *t, const wb_joint *joint, size_t n, const double *poses,
                  const double *velocities, const double *inverse_masses, double *memory,
                  void *replies, int threads, void *scratch) {
    int interfaces = wb_joint_interfaces(t);
    joints all = {t, joint, n, poses, velocities, inverse_masses, memory, replies,
                  threads > 1 ? NULL : scratch};
    if (interfaces < 1 || interfaces > MAX_INTERFACES) return WB_NOT_SQUARE;
    return n ? wb_share(run, &all, n, threads) : WB_OK;
}
