/* Many wrenches in one call, in an order that the caches like, by threads. MIT license.
 *
 * Wrenches are answered in blocks. Within a block those of the axes' methods are looked up axis by
 * axis in the order of the simplices where their walks start, and those of the kriging in the order
 * of their neighbourhoods; each answer is made by wb_reply_of, as that of wb_answer is, so that
 * neither blocks nor threads change a bit.
 */
#include "wb_internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#define WIN32_LEAN_AND_MEAN
#include <windows.h>
typedef HANDLE wb_thread;
#else
#include <pthread.h>
typedef pthread_t wb_thread;
#endif

enum { BLOCK = 2048, RUN = 32, LINE = 64, MAX_THREADS = 256, DIGIT = 11, DIGITS = 3 };

/* Ask for bytes to be brought into the cache; harmless at any address. */
static inline void wb_fetch(const void *at, size_t bytes) {
#ifdef __GNUC__
    for (size_t k = 0; k < bytes; k += LINE) __builtin_prefetch((const char *)at + k);
#else
    (void)at, (void)bytes;
#endif
}

static const wb_options DEFAULTS = {WB_DEFAULT, NULL, 0};

typedef struct {
    uint32_t key, index;
} entry;

typedef struct {
    const wb_table *t;
    const wb_options *o;
    size_t n; /* wrenches */
    const double *inputs;
    double *outputs, *errors, *derivatives;
    unsigned char *coverage;
} task;

/* What a thread works with. */
typedef struct {
    void *scratch;
    double *inputs; /* of the block, without loads on locked freedoms */
    wb_composed *composed;
    entry *order, *spare;
    wb_work work;
} bench;

static void close_bench(bench *b) {
    free(b->scratch), free(b->inputs), free(b->composed), free(b->order), free(b->spare);
}

static int open_bench(const wb_table *t, size_t n, bench *b) {
    size_t count = n < BLOCK ? n : BLOCK;
    b->scratch = malloc(wb_scratch(t));
    b->inputs = malloc(count * (size_t)t->inputs * sizeof(double));
    b->composed = malloc(count * sizeof *b->composed);
    b->order = malloc(count * sizeof *b->order);
    b->spare = malloc(count * sizeof *b->spare);
    if (!b->scratch || !b->inputs || !b->composed || !b->order || !b->spare)
        return close_bench(b), WB_NO_MEMORY;
    b->work = wb_work_of(t, b->scratch);
    return WB_OK;
}

/* Sort entries by key, stably (radix sort). */
static void sort(entry **order, entry **spare, size_t count) {
    for (int digit = 0; digit < DIGITS; digit++) {
        size_t first[1 << DIGIT] = {0}, sum = 0;
        int shift = DIGIT * digit;
        for (size_t i = 0; i < count; i++) first[(*order)[i].key >> shift & ((1 << DIGIT) - 1)]++;
        if (first[(*order)[0].key >> shift & ((1 << DIGIT) - 1)] == count) continue; /* all alike */
        for (size_t d = 0; d < 1 << DIGIT; d++) {
            size_t old = first[d];
            first[d] = sum, sum += old;
        }
        for (size_t i = 0; i < count; i++)
            (*spare)[first[(*order)[i].key >> shift & ((1 << DIGIT) - 1)]++] = (*order)[i];
        entry *held = *order;
        *order = *spare, *spare = held;
    }
}

/* Read an axis for RUN wrenches: what is found is fetched while others are still looked up. */
static void compose_run(const wb_composition *c, int axis, size_t first, size_t used, bench *b) {
    wb_location location[RUN];
    size_t count = used - first < RUN ? used - first : RUN;
    for (size_t i = 0; i < count; i++) {
        const entry *next = &b->order[first + i];
        if (first + i + RUN < used) wb_fetch(&c->simplex[next[RUN].key], sizeof *c->simplex);
        wb_axis_locate(c, axis, b->inputs + 6 * (size_t)next->index, &location[i]);
        if (location[i].simplex >= 0)
            for (int corner = 0; corner < 4; corner++)
                wb_fetch(&c->vertex[c->simplex[location[i].simplex].vertex[corner]], sizeof *c->vertex);
    }
    for (size_t i = 0; i < count; i++) {
        wb_part part;
        size_t at = b->order[first + i].index;
        wb_axis_read(c, axis, b->inputs + 6 * at, &location[i], 0, &part);
        wb_add_axis(&part, axis, &b->composed[at]);
    }
}

/* Compose the block's answers axis by axis: one triangulation at a time is in the caches. */
static void compose_block(const wb_table *t, const wb_group *g, size_t count, bench *b) {
    const wb_composition *c = &g->composition;
    for (size_t i = 0; i < count; i++) wb_compose_start(c, &b->composed[i]);
    for (int axis = 0; axis < 3; axis++) {
        size_t used = 0;
        for (size_t i = 0; i < count; i++) {
            const double *w = b->inputs + 6 * i, *scale = c->floats[axis].scale;
            if (!wb_needs_axis(t->small, w, axis)) continue;
            double x[3] = {w[axis] / scale[0], w[3 + (axis + 1) % 3] / scale[1],
                           w[3 + (axis + 2) % 3] / scale[2]};
            uint32_t key = c->ints[axis].dimension < 1 ? 0 : (uint32_t)wb_hint(c, axis, x);
            b->order[used].key = key, b->order[used++].index = (uint32_t)i;
        }
        if (used) sort(&b->order, &b->spare, used);
        for (size_t i = 0; i < used; i += RUN) compose_run(c, axis, i, used, b);
    }
    for (size_t i = 0; i < count; i++)
        wb_add_moments(c, t->small, b->inputs + 6 * i, &b->composed[i]);
}

/* The order in which a block is answered: that of the kriging's neighbourhoods. */
static void order_block(const wb_table *t, const wb_kriging *k, size_t count, bench *b) {
    for (size_t i = 0; i < count; i++) {
        const double *w = b->inputs + (size_t)t->inputs * i;
        b->order[i].index = (uint32_t)i;
        b->order[i].key = k ? (uint32_t)wb_anchor(t, k, w, &b->work) : 0;
    }
    if (k) sort(&b->order, &b->spare, count);
}

/* Answer a block, each wrench by the routine of single answers. */
static void answer_block(const task *job, size_t start, size_t count, bench *b) {
    const wb_table *t = job->t;
    const wb_group *g = t->groups == 1 && t->group[0].used ? &t->group[0] : NULL;
    int method = g ? wb_method_of(g, job->o) : WB_DEFAULT, axes = g && method <= WB_ADDITIVE;
    size_t n = (size_t)t->inputs, m = (size_t)t->outputs;
    const wb_kriging *k = NULL;
    if (g && method == WB_KRIGING) k = &g->kriging;
    else if (axes && g->has_kriging) k = &g->kriging;
    if (axes) compose_block(t, g, count, b);
    order_block(t, k, count, b);
    for (size_t i = 0; i < count; i++) {
        size_t within = b->order[i].index, index = start + within;
        wb_reply reply;
        wb_reply_of(t, job->o, &b->work, job->inputs + index * n,
                    axes ? &b->composed[within] : NULL, 0, &reply);
        wb_conclude(t, job->o, &b->work, &reply);
        memcpy(job->outputs + m * index, reply.outputs, m * sizeof(double));
        memcpy(job->errors + m * index, reply.error, m * sizeof(double));
        job->coverage[index] = (unsigned char)reply.coverage;
    }
}

/* Answer the blocks first, first + step, ... */
static int run(void *whole, size_t first, size_t step) {
    const task *job = whole;
    const wb_table *t = job->t;
    size_t n = (size_t)t->inputs;
    bench b;
    int wrong = open_bench(t, job->n, &b);
    if (wrong) return wrong;
    for (size_t start = BLOCK * first; start < job->n; start += BLOCK * step) {
        size_t count = job->n - start < BLOCK ? job->n - start : BLOCK;
        if (job->derivatives)
            for (size_t i = start; i < start + count; i++)
                wb_answer_slopes(t, job->o, &b.work, job->inputs + i * n,
                                 job->derivatives + i * n * (size_t)t->outputs);
        if (job->derivatives) continue;
        for (size_t i = 0; i < count; i++)
            for (size_t k = 0; k < n; k++) {
                double load = job->inputs[(start + i) * n + k];
                b.inputs[i * n + k] = t->locked[k] ? 0.0 : load + 0.0;
            }
        answer_block(job, start, count, &b);
    }
    close_bench(&b);
    return WB_OK;
}

/* One thread's part of a job. */
typedef struct {
    wb_run run;
    void *job;
    size_t first, step;
    int wrong;
} share;

static void work_on(share *part) { part->wrong = part->run(part->job, part->first, part->step); }

#ifdef _WIN32
static DWORD WINAPI enter(void *part) { return work_on(part), 0; }
static int start_thread(wb_thread *thread, share *part) {
    return (*thread = CreateThread(NULL, 0, enter, part, 0, NULL)) != NULL;
}
static void join_thread(wb_thread thread) {
    WaitForSingleObject(thread, INFINITE);
    CloseHandle(thread);
}
#else
static void *enter(void *part) { return work_on(part), NULL; }
static int start_thread(wb_thread *thread, share *part) {
    return !pthread_create(thread, NULL, enter, part);
}
static void join_thread(wb_thread thread) { pthread_join(thread, NULL); }
#endif

int wb_share(wb_run run, void *job, size_t blocks, int threads) {
    share part[MAX_THREADS];
    wb_thread thread[MAX_THREADS];
    int started[MAX_THREADS] = {0}, wrong = WB_OK;
    if (threads > MAX_THREADS) threads = MAX_THREADS;
    if (threads < 1) threads = 1;
    if ((size_t)threads > blocks) threads = (int)blocks;
    for (int i = 0; i < threads; i++) {
        part[i] = (share){run, job, (size_t)i, (size_t)threads, WB_OK};
        if (i) started[i] = start_thread(&thread[i], &part[i]);
    }
    for (int i = 0; i < threads; i++)
        if (!started[i]) work_on(&part[i]); /* the first, and any that did not start */
    for (int i = 0; i < threads; i++) {
        if (started[i]) join_thread(thread[i]);
        if (part[i].wrong) wrong = part[i].wrong;
    }
    return wrong;
}

static int check_all(const task *whole) {
    for (size_t i = 0; i < whole->n; i++) {
        int wrong = wb_check(whole->t, whole->o, whole->inputs + i * (size_t)whole->t->inputs);
        if (wrong) return wrong;
    }
    return whole->n >= UINT32_MAX ? WB_NO_MEMORY : WB_OK;
}

int wb_answer_many(const wb_table *t, const wb_options *options, size_t n, const double *inputs,
                   double *outputs, double *errors, unsigned char *coverage, int threads) {
    task whole = {t, options ? options : &DEFAULTS, n, inputs, outputs, errors, NULL, coverage};
    int wrong = check_all(&whole);
    return wrong || !n ? wrong : wb_share(run, &whole, (n + BLOCK - 1) / BLOCK, threads);
}

int wb_derivative_many(const wb_table *t, const wb_options *options, size_t n,
                       const double *inputs, double *du_dw, int threads) {
    task whole = {t, options ? options : &DEFAULTS, n, inputs, NULL, NULL, du_dw, NULL};
    int wrong = check_all(&whole);
    return wrong || !n ? wrong : wb_share(run, &whole, (n + BLOCK - 1) / BLOCK, threads);
}
