/* From the directory of a packed table to what answers read. MIT license.
 *
 * Names, types and shapes are those of wb_arrays.h; sizes are checked against each other, and every
 * index of a small array against what it points into. The indices of large arrays (simplices,
 * grids) are checked where they are followed, so that opening a table does not read it. A checked
 * file therefore never leads an answer beyond its end.
 */
#include "wb_arrays.h"
#include "wb_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* What reads one table: `block` is what names begin with, `size` the sizes known so far, or -1. */
typedef struct {
    wb_table *t;
    char block[WB_NAME], bad[2 * WB_NAME];
    int64_t size[WB_SIZES];
} reader;

enum {
    SECOND_SMOOTHNESS = 4, /* p of Matern p + 1/2 that wb_kriging.c has for second derivatives */
    MAX_EQUATIONS = 100000
};

/* Bytes: with a scratch 16 or 48 bytes off a line an answer from 60 rows with second derivatives
 * takes 11 to 13 % longer. */
enum { CACHE_LINE = 64 };

static const size_t SIZE[5] = {0, 8, 4, 8, 1};

static void fail(reader *r, const char *name) {
    if (!*r->bad) snprintf(r->bad, sizeof r->bad, "%s%s", r->block, name);
}

static void require(reader *r, const char *name, int sound) {
    if (!sound) fail(r, name);
}

/* An array of the block, or NULL. */
static const wb_entry *find(const reader *r, const char *name) {
    char whole[2 * WB_NAME];
    uint64_t low = 0, high = r->t->arrays;
    snprintf(whole, sizeof whole, "%s%s", r->block, name);
    while (low < high) {
        uint64_t middle = low + (high - low) / 2;
        const wb_entry *entry = (const wb_entry *)r->t->directory + middle;
        int order = strncmp(entry->name, whole, WB_NAME);
        if (!order) return entry;
        if (order < 0) low = middle + 1;
        else high = middle;
    }
    return NULL;
}

/* The bytes of an array, after its type and shape; a size that is not known yet is the file's. */
static const void *take(reader *r, const wb_array *array) {
    const wb_table *t = r->t;
    const wb_entry *entry = find(r, array->name);
    uint64_t count = 1;
    if (!entry && array->optional) return NULL;
    if (!entry || entry->type != (uint32_t)array->type
        || entry->dimensions != (uint32_t)array->dimensions)
        return fail(r, array->name), NULL;
    for (int k = 0; k < array->dimensions; k++) {
        int64_t fixed = -(int64_t)array->shape[k];
        int64_t *size = fixed > 0 ? &fixed : &r->size[array->shape[k]];
        if (entry->shape[k] > INT32_MAX) return fail(r, array->name), NULL;
        if (*size < 0) *size = (int64_t)entry->shape[k];
        count *= entry->shape[k];
        if ((uint64_t)*size != entry->shape[k] || count > t->size)
            return fail(r, array->name), NULL;
    }
    if (entry->bytes != count * SIZE[array->type] || entry->offset % 64 || entry->offset > t->size
        || t->size - entry->offset < entry->bytes)
        return fail(r, array->name), NULL;
    return t->bytes + entry->offset;
}

/* Point the members of a struct to the arrays of a block; sizes from `first` on are the block's. */
static int read_arrays(reader *r, const wb_array *arrays, size_t count, int first, void *target) {
    for (int k = first; k < WB_SIZES; k++) r->size[k] = -1;
    for (size_t k = 0; k < count && !*r->bad; k++) {
        const void *bytes = take(r, &arrays[k]);
        memcpy((char *)target + arrays[k].member, &bytes, sizeof bytes);
    }
    return !*r->bad;
}

#define READ(r, block, first, target)                                                  \
    read_arrays(r, WB_##block##_ARRAYS, sizeof(WB_##block##_ARRAYS) / sizeof(wb_array), \
                first, target)

/* Refuse an array that points out of what it points into. */
static void within(reader *r, const char *name, const int32_t *values, int64_t count, int64_t low,
                   int64_t high) {
    for (int64_t k = 0; !*r->bad && k < count; k++)
        if (values[k] < low || values[k] >= high) fail(r, name);
}

static void read_space(reader *r) {
    wb_table *t = r->t;
    snprintf(r->block, sizeof r->block, "space/");
    const int32_t *sizes = take(r, &WB_SPACE_ARRAYS[0]); /* of which the other shapes are */
    if (!sizes) return;
    within(r, "sizes", sizes, 3, 1, WB_MAX + 1);
    if (*r->bad) return;
    r->size[WB_OF_N] = t->inputs = sizes[0], r->size[WB_OF_M] = t->outputs = sizes[1];
    r->size[WB_OF_N1] = t->inputs + 1, t->groups = sizes[2];
    if (!READ(r, SPACE, WB_BLOCK, t)) return;
    t->vectors = (int)r->size[WB_OF_V];
    within(r, "vector_first", t->vector_first, t->vectors, 0, (int64_t)t->outputs - 2);
    snprintf(r->block, sizeof r->block, "scene/");
    if (find(r, "ends")) READ(r, SCENE, WB_BLOCK, t);
}

static void read_solver(reader *r) {
    wb_table *t = r->t;
    wb_solver *s = &t->solver;
    snprintf(r->block, sizeof r->block, "solver/");
    if (*r->bad || !READ(r, SOLVER, WB_BLOCK, s)) return;
    s->by_tangent = s->flags[0], s->mesh_known = s->flags[1], s->linear = s->flags[2];
    s->linearity_known = s->flags[3], s->whole = s->flags[4], s->none = 1;
    for (int k = 0; k < t->outputs * t->inputs; k++) s->none &= s->mesh[k] == 0;
    for (int q = 0; q < t->outputs; q++) s->none &= s->linearity[q] == 0;
    s->none &= !s->second;
    s->none &= !s->by_tangent;
}

/* Where searches among `count` ascending numbers start. */
static int64_t buckets_of(reader *r, const int32_t *start, int64_t count) {
    int64_t bounds = r->size[WB_OF_B];
    require(r, "start", bounds > 1);
    within(r, "start", start, bounds, 0, count + 1);
    return bounds - 1;
}

static void read_rows(reader *r, wb_rows *rows) {
    if (!READ(r, ROW, WB_BLOCK, rows)) return;
    rows->count = r->size[WB_OF_R], rows->tangents = r->size[WB_OF_T];
    rows->buckets = buckets_of(r, rows->start, rows->count);
    within(r, "tangent_of", rows->tangent_of, rows->count, -1, rows->tangents);
}

static void read_cut(reader *r, wb_composition *c, int moment, int which) {
    wb_cut *cut = &c->cuts[moment][which];
    /* The axis that the moment comes first in, then the one that it comes second in. */
    int axis = (moment + (which ? 1 : 2)) % 3;
    if (!(cut->present = find(r, "state") != NULL) || !READ(r, CUT, WB_BLOCK, cut)) return;
    int64_t count = r->size[WB_OF_K], stations = count ? count + 1 : 0;
    require(r, "stations", r->size[WB_OF_U] == stations);
    cut->stretches = (int)count, cut->buckets = buckets_of(r, cut->start, stations);
    cut->scale = c->floats[axis].scale[1 + which];
}

/* Check one axis' frame: the sizes of its grid and its part of the points and simplices. */
static void check_axis(reader *r, const wb_composition *c, int axis) {
    const wb_axis_ints *ints = &c->ints[axis];
    int64_t size = 1;
    int32_t facets = c->facet_first[axis + 1] - c->facet_first[axis];
    within(r, "ints", &ints->dimension, 1, -1, 4);
    if (*r->bad || ints->dimension < 0) return;
    if (c->simplex_first[axis + 1] <= c->simplex_first[axis]) fail(r, "simplex_first");
    if (c->point_first[axis + 1] - c->point_first[axis] <= ints->dimension)
        fail(r, "point_first");
    if (ints->first_cell < 0 || (ints->dimension ? facets < 1 : facets > 0)) fail(r, "ints");
    for (int k = 0; k < 3; k++) {
        if (ints->cells[k] < 1 || ints->cells[k] > c->cells) fail(r, "ints");
        size *= *r->bad ? 1 : ints->cells[k];
        if (ints->first_cell + size > c->cells) fail(r, "ints");
        if (*r->bad) return;
    }
}

static void check_first(reader *r, const char *name, const int32_t *first, int64_t end) {
    if (*r->bad) return;
    within(r, name, first, 4, 0, end + 1);
    if (first[0] != 0 || first[3] != end) fail(r, name);
    for (int k = 0; k < 3; k++)
        if (first[k + 1] < first[k]) fail(r, name);
}

static void read_composition(reader *r, wb_composition *c, const char *group) {
    if (!READ(r, AXES, WB_BLOCK, c)) return;
    int64_t facets = r->size[WB_OF_F];
    c->simplices = r->size[WB_OF_I], c->points = r->size[WB_OF_P], c->cells = r->size[WB_OF_G];
    require(r, "vertex", r->t->inputs == 6 && r->t->outputs == 6);
    check_first(r, "facet_first", c->facet_first, facets);
    check_first(r, "simplex_first", c->simplex_first, c->simplices);
    check_first(r, "point_first", c->point_first, c->points);
    for (int axis = 0; !*r->bad && axis < 3; axis++) check_axis(r, c, axis);
    for (int64_t f = 0; !*r->bad && f < facets; f++) {
        within(r, "facets", c->facets + 4 * f, 3, 0, c->points);
        within(r, "facets", c->facets + 4 * f + 3, 1, 0, c->simplices);
    }
    for (int k = 0; !*r->bad && k < 6; k++) {
        snprintf(r->block, sizeof r->block, "%saxes/cut%d%d/", group, k / 2, k % 2);
        read_cut(r, c, k / 2, k % 2);
    }
}

static void read_factor(reader *r, const wb_kriging *k, wb_factor *factor) {
    if (!READ(r, FACTOR, WB_FACTOR, factor)) return;
    int64_t e = r->size[WB_OF_E], panels = e / WB_PANEL;
    factor->count = r->size[WB_OF_K], factor->padded = (int)e;
    require(r, "equations", e % WB_PANEL == 0 && e <= MAX_EQUATIONS);
    require(r, "panels", r->size[WB_OF_D] == WB_PANEL * WB_PANEL * panels * (panels + 1) / 2);
    within(r, "number", factor->number, k->stride, 0, factor->count);
    within(r, "equations", factor->equations, factor->count * e, 0, (int64_t)k->per_row * k->stride);
    if (!*r->bad && factor->padded > r->t->max_padded) r->t->max_padded = factor->padded;
}

/* A kriging, and the next of the table's factors; whether there is one. */
static int read_kriging(reader *r, const char *group, const char *which, wb_kriging *k,
                        wb_factor **factor) {
    wb_table *t = r->t;
    int n = t->inputs;
    snprintf(r->block, sizeof r->block, "%s%s/", group, which);
    if (*r->bad || !find(r, "x")) return 0;
    if (!READ(r, KRIGING, WB_BLOCK, k)) return 1;
    k->stride = (int)r->size[WB_OF_S];
    int64_t terms = r->size[WB_OF_C];
    k->has_second = k->smoothness != NULL;
    k->per_row = n + 1 + (k->has_second ? n * (n + 1) / 2 : 0);
    require(r, "x", k->stride > 0 && k->stride % WB_LANES == 0);
    require(r, "weights", r->size[WB_OF_W] == (int64_t)k->per_row * k->stride);
    if (k->has_second) within(r, "smoothness", k->smoothness, 1, SECOND_SMOOTHNESS, SECOND_SMOOTHNESS + 1);
    within(r, "factor_count", k->factor_count, 1, 1, t->outputs + 1);
    if (*r->bad) return 1;
    k->factors = *k->factor_count, k->factor = *factor, *factor += k->factors;
    k->terms = (int)(terms / k->factors);
    require(r, "terms", terms > 0 && terms % k->factors == 0);
    for (int s = 0; s < k->factors && !*r->bad; s++) {
        snprintf(r->block, sizeof r->block, "%s%s/factor%d/", group, which, s);
        k->factor[s].term = k->term + s * k->terms * (n + 1);
        k->factor[s].rates = k->factor[s].term + (k->terms - 1) * (n + 1);
        read_factor(r, k, &k->factor[s]);
    }
    int flat = k->per_row * k->stride; /* a dimension of `weights` */
    if (k->stride > t->max_stride) t->max_stride = k->stride;
    if (flat > t->max_flat) t->max_flat = flat;
    if (k->terms > t->max_terms) t->max_terms = k->terms;
    return 1;
}

/* Each output of a group is answered by one factor: by none it would have no value and no error. */
static void each_by_one(reader *r, const wb_group *g, const wb_kriging *k) {
    for (int q = 0; !*r->bad && q < r->t->outputs; q++) {
        int count = 0;
        for (int s = 0; s < k->factors; s++) count += k->factor[s].outputs[q] != 0;
        if (g->outputs[q] && count != 1) fail(r, "factor/outputs");
    }
}

static void read_group(reader *r, int number, wb_group *g, wb_factor **factor) {
    char group[16];
    snprintf(group, sizeof group, "g%d/", number);
    snprintf(r->block, sizeof r->block, "%s", group);
    if (!READ(r, GROUP, WB_BLOCK, g)) return;
    g->judged = g->held ? g->held : g->outputs;
    for (int q = 0; q < r->t->outputs; q++)
        if (g->outputs[q]) g->judged = g->outputs;
    const int32_t *flags = g->flags;
    snprintf(r->block, sizeof r->block, "%sfit/", group);
    if (!READ(r, FIT, WB_BLOCK, &g->fit)) return;
    snprintf(r->block, sizeof r->block, "%srow/", group);
    read_rows(r, &g->rows);
    g->method = flags[0], g->exact_fit = flags[1], g->used = flags[2], g->has_rows = flags[3];
    snprintf(r->block, sizeof r->block, "%saxes/", group);
    g->composition.fit = &g->fit;
    g->has_composition = find(r, "vertex") != NULL;
    if (!*r->bad && g->has_composition) read_composition(r, &g->composition, group);
    g->has_kriging = read_kriging(r, group, "kriging", &g->kriging, factor);
    if (g->has_kriging) each_by_one(r, g, &g->kriging);
    within(r, "flags", flags, 1, 0, WB_METHODS);
    require(r, "flags", !g->used || g->has_composition || g->has_kriging || g->exact_fit);
    require(r, "flags", !g->used || g->method != WB_KRIGING || g->has_kriging);
    require(r, "flags", !g->used || g->method > WB_ADDITIVE || g->has_composition);
}

/* The directory's and the JSON block's position; 0 if they are not in the file. */
static int read_frame(wb_table *t) {
    wb_header head;
    memcpy(&head, t->bytes, sizeof head);
    if (head.directory % 8 || head.directory > t->size || head.arrays > 100000
        || (t->size - head.directory) / sizeof(wb_entry) < head.arrays)
        return 0;
    if (head.json > t->size || t->size - head.json <= head.json_size) return 0;
    t->directory = t->bytes + head.directory, t->arrays = head.arrays;
    t->json = (const char *)t->bytes + head.json;
    return t->json[head.json_size] == 0;
}

static int read_all(wb_table *t, char *why, size_t room) {
    reader r = {t, "", "", {0}};
    if (!read_frame(t)) return snprintf(why, room, "the table's directory is damaged"), 0;
    read_space(&r);
    read_solver(&r);
    if (!*r.bad) {
        size_t groups = (size_t)t->groups;
        t->group = calloc(groups, sizeof *t->group);
        t->factor = calloc(2 * groups * (size_t)t->outputs, sizeof *t->factor);
        if (!t->group || !t->factor) return snprintf(why, room, "no memory"), 0;
    }
    wb_factor *factor = t->factor;
    for (int i = 0; !*r.bad && i < t->groups; i++) read_group(&r, i, &t->group[i], &factor);
    if (!*r.bad) return 1;
    return snprintf(why, room, "the table's array %s is missing or of another shape", r.bad), 0;
}

static wb_table *make(const unsigned char *bytes, size_t size, size_t mapped, char *why,
                      size_t room) {
    wb_table *t = calloc(1, sizeof *t);
    if (!t) return snprintf(why, room, "no memory"), NULL;
    t->bytes = bytes, t->size = size, t->mapped = mapped;
    if (read_all(t, why, room)) return t;
    wb_close(t);
    return NULL;
}

wb_table *wb_open(const char *path, char *why, size_t room) {
    size_t size = 0;
    const unsigned char *bytes = wb_map(path, &size, why, room);
    return bytes ? make(bytes, size, size, why, room) : NULL;
}

wb_table *wb_open_bytes(const void *bytes, size_t count, char *why, size_t room) {
    if ((uintptr_t)bytes % 8)
        return snprintf(why, room, "the bytes of the table are not aligned to 8 bytes"), NULL;
    return wb_check_bytes(bytes, count, why, room) ? make(bytes, count, 0, why, room) : NULL;
}

wb_table *wb_open_checked(const void *bytes, size_t count, char *why, size_t room) {
    return make(bytes, count, 0, why, room);
}

void wb_close(wb_table *t) {
    if (!t) return;
    wb_unmap(t);
    free(t->factor);
    free(t->group);
    free(t);
}

wb_work wb_work_of(const wb_table *t, void *scratch) {
    size_t n = (size_t)t->inputs, stride = (size_t)t->max_stride, e = (size_t)t->max_padded;
    double *all = (double *)(((uintptr_t)scratch + CACHE_LINE - 1) & ~(uintptr_t)(CACHE_LINE - 1));
    wb_work work = {0};
    work.apart = all, all += n * stride;
    work.flat = all, all += (size_t)t->max_flat;
    work.first = all, all += stride;
    work.second = all, all += stride;
    work.wide = all, all += 3 * stride * (size_t)t->max_terms;
    work.chosen = all, all += e;
    work.reduced = all;
    return work;
}

size_t wb_scratch(const wb_table *t) {
    size_t n = (size_t)t->inputs, stride = (size_t)t->max_stride;
    size_t rows = stride * (n + 2 + 3 * (size_t)t->max_terms) + (size_t)t->max_flat;
    return (rows + 2 * (size_t)t->max_padded) * sizeof(double) + CACHE_LINE;
}

int wb_inputs(const wb_table *t) { return t->inputs; }
int wb_outputs(const wb_table *t) { return t->outputs; }
const char *wb_json(const wb_table *t) { return t->json; }
