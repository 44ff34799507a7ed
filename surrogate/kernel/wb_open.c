/* From the directory of a packed table to what answers read. MIT license.
 *
 * Names, types and shapes are checked against each other, and every index of a small array against
 * what it points into. The indices of large arrays (simplices, grids) are checked where they are
 * followed, so that opening a table does not read it. A checked file therefore never leads an
 * answer beyond its end.
 */
#include "wb_file.h"

#include <limits.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    wb_table *t;
    const char *group; /* what names begin with */
    char bad[WB_NAME + 32];
} reader;

enum { BENT_SMOOTHNESS = 4 }; /* p of Matern p + 1/2 that wb_kriging.c has for second derivatives */

static const size_t SIZE[5] = {0, 8, 4, 8, 1};

static void fail(reader *r, const char *name) {
    if (!*r->bad) snprintf(r->bad, sizeof r->bad, "%s%s", r->group, name);
}

static const wb_entry *find(const wb_table *t, const char *name) {
    uint64_t low = 0, high = t->arrays;
    while (low < high) {
        uint64_t middle = low + (high - low) / 2;
        const wb_entry *entry = (const wb_entry *)t->directory + middle;
        int order = strncmp(entry->name, name, WB_NAME);
        if (!order) return entry;
        if (order < 0) low = middle + 1;
        else high = middle;
    }
    return NULL;
}

/* An array of a type; each -1 among the dimensions is filled in with what the file has. */
static const void *take(reader *r, const char *name, unsigned type, int dimensions,
                        int64_t *shape) {
    char whole[WB_NAME];
    uint64_t count = 1;
    snprintf(whole, sizeof whole, "%s%s", r->group, name);
    const wb_entry *entry = find(r->t, whole);
    if (!entry || entry->type != type || entry->dimensions != (uint32_t)dimensions)
        return fail(r, name), NULL;
    for (int k = 0; k < dimensions; k++) {
        if (entry->shape[k] > INT32_MAX || (shape[k] >= 0 && entry->shape[k] != (uint64_t)shape[k]))
            return fail(r, name), NULL;
        shape[k] = (int64_t)entry->shape[k];
        count *= entry->shape[k];
        if (count > r->t->size) return fail(r, name), NULL;
    }
    if (entry->bytes != count * SIZE[type] || entry->offset % 64 || entry->offset > r->t->size
        || r->t->size - entry->offset < entry->bytes)
        return fail(r, name), NULL;
    return r->t->bytes + entry->offset;
}

static const double *doubles(reader *r, const char *name, int dimensions, ...) {
    int64_t shape[4];
    va_list list;
    va_start(list, dimensions);
    for (int k = 0; k < dimensions; k++) shape[k] = va_arg(list, int64_t);
    va_end(list);
    return take(r, name, WB_F8, dimensions, shape);
}

static const int32_t *ints(reader *r, const char *name, int64_t count) {
    return take(r, name, WB_I4, 1, &count);
}

static int64_t length(reader *r, const char *name, unsigned type, int dimensions) {
    int64_t shape[4] = {-1, -1, -1, -1};
    return take(r, name, type, dimensions, shape) ? shape[0] : 0;
}

/* Refuse an array that points out of what it points into. */
static void within(reader *r, const char *name, const int32_t *values, int64_t count, int64_t low,
                   int64_t high) {
    for (int64_t k = 0; !*r->bad && k < count; k++)
        if (values[k] < low || values[k] >= high) fail(r, name);
}

static int exists(const reader *r, const char *name) {
    char whole[WB_NAME];
    snprintf(whole, sizeof whole, "%s%s", r->group, name);
    return find(r->t, whole) != NULL;
}

static void read_space(reader *r) {
    wb_table *t = r->t;
    const int32_t *sizes = ints(r, "space/sizes", 3);
    if (!sizes) return;
    within(r, "space/sizes", sizes, 3, 1, WB_MOST + 1);
    if (*r->bad) return;
    t->inputs = sizes[0], t->outputs = sizes[1], t->groups = sizes[2];
    int64_t n = t->inputs, m = t->outputs;
    t->locked = ints(r, "space/locked", n);
    t->ends = doubles(r, "space/ends", 2, (int64_t)2, n);
    t->scale = doubles(r, "space/scale", 1, n);
    t->small = doubles(r, "space/small", 1, n);
    t->tolerance = doubles(r, "space/tolerance", 1, m);
    t->limit = doubles(r, "space/limit", 1, m);
    if (exists(r, "space/rig_error")) t->rig_error = doubles(r, "space/rig_error", 1, m);
    if (exists(r, "scene/ends")) {
        t->scene_ends = doubles(r, "scene/ends", 2, (int64_t)2, n);
        t->scene_varying = ints(r, "scene/varying", n);
        t->scene_slopes = ints(r, "scene/slopes", n);
    }
    t->vectors = (int)length(r, "space/vector_first", WB_I4, 1);
    t->vector_first = ints(r, "space/vector_first", t->vectors);
    t->vector_limit = doubles(r, "space/vector_limit", 1, (int64_t)t->vectors);
    if (!*r->bad) within(r, "space/vector_first", t->vector_first, t->vectors, 0, m - 2);
}

static void read_solver(reader *r) {
    wb_table *t = r->t;
    wb_solver *s = &t->solver;
    const int32_t *flags = ints(r, "solver/flags", 5);
    s->mesh = doubles(r, "solver/mesh", 2, (int64_t)t->outputs, (int64_t)t->inputs);
    s->square = doubles(r, "solver/square", 1, (int64_t)t->outputs);
    s->one_over = doubles(r, "solver/one_over", 1, (int64_t)t->inputs);
    if (exists(r, "solver/zero")) s->zero = doubles(r, "solver/zero", 1, (int64_t)t->inputs);
    s->stiffness = doubles(r, "solver/stiffness", 2, (int64_t)t->inputs, (int64_t)t->outputs);
    if (*r->bad) return;
    s->asks = flags[0], s->mesh_known = flags[1], s->linear = flags[2];
    s->linearity_known = flags[3], s->whole = flags[4], s->none = 1;
    for (int k = 0; k < t->outputs * t->inputs; k++) s->none &= s->mesh[k] == 0;
    for (int q = 0; q < t->outputs; q++) s->none &= s->square[q] == 0;
    s->none &= !s->asks;
}

static void read_fit(reader *r, wb_fit *fit) {
    fit->matrix = doubles(r, "fit/matrix", 2, (int64_t)r->t->outputs, (int64_t)r->t->inputs);
    fit->bar = doubles(r, "fit/bar", 1, (int64_t)r->t->outputs);
    if (exists(r, "fit/offset"))
        fit->offset = doubles(r, "fit/offset", 1, (int64_t)r->t->outputs);
    fit->known = ints(r, "fit/known", r->t->inputs);
}

/* Where searches among `count` ascending numbers start. */
static const int32_t *read_start(reader *r, const char *name, int64_t count, int64_t *buckets) {
    int64_t size = length(r, name, WB_I4, 1);
    const int32_t *start = ints(r, name, size);
    if (size < 2) fail(r, name);
    if (!*r->bad) within(r, name, start, size, 0, count + 1);
    *buckets = size - 1;
    return start;
}

static void read_rows(reader *r, wb_rows *rows) {
    int64_t n = r->t->inputs, m = r->t->outputs, one = rows->count = length(r, "row/key", WB_F8, 1);
    rows->key = doubles(r, "row/key", 1, one);
    rows->rates = doubles(r, "row/rates", 1, n);
    rows->steepest = doubles(r, "row/steepest", 1, m);
    rows->wrench = doubles(r, "row/wrench", 2, one, n);
    rows->moved = doubles(r, "row/moved", 2, one, m);
    rows->bar = doubles(r, "row/bar", 2, one, m);
    rows->number = ints(r, "row/number", one);
    rows->tangent_of = ints(r, "row/tangent_of", one);
    rows->seq = take(r, "row/seq", WB_I8, 1, &one);
    rows->bucket = doubles(r, "row/bucket", 1, (int64_t)2);
    rows->start = read_start(r, "row/start", rows->count, &rows->buckets);
    rows->tangents = length(r, "row/tangent", WB_F8, 3);
    rows->tangent = doubles(r, "row/tangent", 3, rows->tangents, m, n);
}

static void read_cut(reader *r, wb_composition *c, int moment, int which) {
    static const char *const PARTS[] = {"stations", "outputs", "stated", "unit", "state", "bucket",
                                        "start"};
    char name[7][32];
    wb_cut *cut = &c->cuts[moment][which];
    for (int k = 0; k < 7; k++)
        snprintf(name[k], sizeof name[k], "axes/cut%d%d/%s", moment, which, PARTS[k]);
    if (!(cut->present = exists(r, name[4]))) return;
    /* The axis that the moment comes first in, then the one that it comes second in. */
    int axis = (moment + (which ? 1 : 2)) % 3;
    int64_t count = length(r, name[4], WB_I4, 1);
    cut->stretches = (int)count;
    cut->scale = *r->bad ? 1.0 : c->floats[axis].scale[1 + which];
    cut->error = *r->bad ? NULL : c->error + 12 * axis;
    cut->stations = doubles(r, name[0], 1, count ? count + 1 : (int64_t)0);
    cut->outputs = doubles(r, name[1], 3, count, (int64_t)2, (int64_t)6);
    cut->stated = doubles(r, name[2], 3, count, (int64_t)2, (int64_t)6);
    cut->unit = doubles(r, name[3], 2, count, (int64_t)3);
    cut->state = ints(r, name[4], count);
    cut->bucket = doubles(r, name[5], 1, (int64_t)2);
    cut->start = read_start(r, name[6], count ? count + 1 : 0, &cut->buckets);
}

/* Check one axis' frame: the sizes of its grid and its part of the points and simplices. */
static void check_axis(reader *r, const wb_composition *c, int axis) {
    const wb_axis_ints *own = &c->ints[axis];
    int64_t size = 1;
    int32_t facets = c->facet_first[axis + 1] - c->facet_first[axis];
    within(r, "axes/ints", &own->dimension, 1, -1, 4);
    if (*r->bad || own->dimension < 0) return;
    if (c->simplex_first[axis + 1] <= c->simplex_first[axis]) fail(r, "axes/simplex_first");
    if (c->point_first[axis + 1] - c->point_first[axis] <= own->dimension)
        fail(r, "axes/point_first");
    if (own->first_cell < 0 || (own->dimension ? facets < 1 : facets > 0)) fail(r, "axes/ints");
    for (int k = 0; k < 3; k++) {
        if (own->cells[k] < 1 || own->cells[k] > c->cells) fail(r, "axes/ints");
        size *= *r->bad ? 1 : own->cells[k];
        if (own->first_cell + size > c->cells) fail(r, "axes/ints");
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

static void read_composition(reader *r, wb_composition *c, const wb_fit *fit) {
    int64_t facets = length(r, "axes/facets", WB_I4, 2), shape[2] = {-1, 16}, flat[2] = {3, 5};
    int64_t corners[2] = {facets, 4};
    c->fit = fit;
    c->simplex = take(r, "axes/simplex", WB_F8, 2, shape);
    c->simplices = shape[0], shape[0] = -1;
    c->vertex = take(r, "axes/vertex", WB_F8, 2, shape);
    c->points = shape[0];
    c->slopes = doubles(r, "axes/slopes", 3, c->points, (int64_t)6, (int64_t)3);
    c->state = take(r, "axes/state", WB_U1, 1, &c->simplices);
    c->cells = length(r, "axes/grid", WB_I4, 1);
    c->grid = ints(r, "axes/grid", c->cells);
    c->ints = take(r, "axes/ints", WB_I4, 2, flat);
    c->floats = (const wb_axis_floats *)doubles(r, "axes/floats", 2, (int64_t)3, (int64_t)22);
    c->facets = take(r, "axes/facets", WB_I4, 2, corners);
    c->facet_first = ints(r, "axes/facet_first", 4);
    c->simplex_first = ints(r, "axes/simplex_first", 4);
    c->point_first = ints(r, "axes/point_first", 4);
    c->fewest = ints(r, "axes/fewest", 3);
    c->left_out = ints(r, "axes/left_out", 4);
    c->together = ints(r, "axes/together", 3);
    c->largest = doubles(r, "axes/largest", 1, (int64_t)4);
    c->rest_point = doubles(r, "axes/rest_point", 2, (int64_t)2, (int64_t)6);
    c->error = doubles(r, "axes/error", 3, (int64_t)3, (int64_t)2, (int64_t)6);
    if (r->t->inputs != 6 || r->t->outputs != 6) fail(r, "axes/vertex");
    check_first(r, "axes/facet_first", c->facet_first, facets);
    check_first(r, "axes/simplex_first", c->simplex_first, c->simplices);
    check_first(r, "axes/point_first", c->point_first, c->points);
    for (int axis = 0; !*r->bad && axis < 3; axis++) check_axis(r, c, axis);
    for (int m = 0; m < 3; m++)
        for (int k = 0; !*r->bad && k < 2; k++) read_cut(r, c, m, k);
    if (*r->bad) return;
    for (int64_t f = 0; f < facets; f++) {
        within(r, "axes/facets", c->facets + 4 * f, 3, 0, c->points);
        within(r, "axes/facets", c->facets + 4 * f + 3, 1, 0, c->simplices);
    }
}

static void read_share(reader *r, const char *kriging, int number, const wb_kriging *k,
                       wb_share *share) {
    static const char *const PARTS[] = {"outputs", "number", "places", "panels", "unsettled",
                                        "least", "penalty", "mean_covariance", "sigma", "factors",
                                        "reach"};
    char name[11][WB_NAME];
    int64_t n = r->t->inputs, shape[2] = {-1, -1};
    for (int part = 0; part < 11; part++)
        snprintf(name[part], sizeof name[part], "%.16s/share%d/%s", kriging, number, PARTS[part]);
    share->outputs = ints(r, name[0], r->t->outputs);
    share->number = ints(r, name[1], k->stride);
    share->places = take(r, name[2], WB_I4, 2, shape);
    if (*r->bad || shape[1] % WB_PANEL || shape[1] > 100000) {
        fail(r, name[2]);
        return;
    }
    int64_t panels = shape[1] / WB_PANEL, triangle = WB_PANEL * WB_PANEL * panels * (panels + 1) / 2;
    share->count = shape[0], share->padded = (int)shape[1];
    share->panels = doubles(r, name[3], 2, shape[0], triangle);
    share->unsettled = doubles(r, name[4], 3, shape[0], n + 1, shape[1]);
    share->least = doubles(r, name[5], 1, (int64_t)k->stride);
    share->penalty = doubles(r, name[6], 1, (int64_t)k->stride);
    share->mean_covariance = doubles(r, name[7], 2, n + 1, n + 1);
    share->levels = length(r, name[8], WB_F8, 1);
    share->sigma = doubles(r, name[8], 1, share->levels);
    share->factors = doubles(r, name[9], 2, share->levels, (int64_t)r->t->outputs);
    share->reach = doubles(r, name[10], 1, (int64_t)1);
    if (*r->bad) return;
    within(r, name[1], share->number, k->stride, 0, share->count);
    within(r, name[2], share->places, shape[0] * shape[1], 0, (int64_t)k->readings * k->stride);
    if (share->padded > r->t->most_padded) r->t->most_padded = share->padded;
}

static void read_kriging(reader *r, const char *which, wb_kriging *k, wb_share **share) {
    char name[16][48];
    static const char *const PARTS[] = {"x", "terms", "rates", "weights", "coefficients", "centre",
                                        "rate", "offset", "spread", "deviation", "lost", "floor",
                                        "tangent", "span", "shares", "smoothness"};
    int64_t n = r->t->inputs, m = r->t->outputs, shape[2] = {n, -1};
    for (int part = 0; part < 16; part++)
        snprintf(name[part], sizeof name[part], "%s/%s", which, PARTS[part]);
    k->x = take(r, name[0], WB_F8, 2, shape);
    if (*r->bad || shape[1] % WB_LANES || shape[1] < 1) {
        fail(r, name[0]);
        return;
    }
    k->stride = (int)shape[1];
    k->terms = (int)length(r, name[1], WB_F8, 2);
    k->term = doubles(r, name[1], 2, (int64_t)k->terms, n + 1);
    k->rates = doubles(r, name[2], 1, n);
    k->bent = exists(r, name[15]);
    k->readings = (int)(n + 1 + (k->bent ? n * (n + 1) / 2 : 0));
    if (k->bent) {
        const int32_t *smoothness = ints(r, name[15], 1);
        if (smoothness) within(r, name[15], smoothness, 1, BENT_SMOOTHNESS, BENT_SMOOTHNESS + 1);
    }
    k->weights = doubles(r, name[3], 2, m, (int64_t)k->readings * k->stride);
    k->coefficients = doubles(r, name[4], 2, n + 1, m);
    k->centre = doubles(r, name[5], 1, n), k->rate = doubles(r, name[6], 1, n);
    k->offset = doubles(r, name[7], 1, m), k->spread = doubles(r, name[8], 1, m);
    k->deviation = doubles(r, name[9], 1, m), k->lost = doubles(r, name[10], 1, m);
    k->floor = doubles(r, name[11], 1, (int64_t)1);
    k->tangent = doubles(r, name[12], 2, m, n);
    k->span = doubles(r, name[13], 2, (int64_t)2, n);
    const int32_t *shares = ints(r, name[14], 1);
    if (!*r->bad) within(r, name[14], shares, 1, 1, m + 1);
    if (*r->bad) return;
    k->shares = *shares, k->share = *share, *share += k->shares;
    for (int s = 0; s < k->shares && !*r->bad; s++) read_share(r, which, s, k, &k->share[s]);
    if (k->stride > r->t->most_stride) r->t->most_stride = k->stride;
    int flat = *r->bad ? 0 : k->readings * k->stride; /* a dimension of `weights` */
    if (flat > r->t->most_flat) r->t->most_flat = flat;
    if (k->terms > r->t->most_terms) r->t->most_terms = k->terms;
}

/* Each output of a group is answered by one share: by none it would have no value and no error. */
static void each_by_one(reader *r, const wb_group *g, const wb_kriging *k) {
    for (int q = 0; !*r->bad && q < r->t->outputs; q++) {
        int count = 0;
        for (int s = 0; s < k->shares; s++) count += k->share[s].outputs[q] != 0;
        if (g->outputs[q] && count != 1) fail(r, "share/outputs");
    }
}

static void read_group(reader *r, wb_group *g, wb_share **share) {
    const wb_table *t = r->t;
    const int32_t *flags = ints(r, "flags", 9);
    g->outputs = ints(r, "outputs", t->outputs);
    g->allowed = doubles(r, "allowed", 1, (int64_t)t->outputs);
    read_fit(r, &g->fit);
    read_rows(r, &g->rows);
    if (*r->bad) return;
    g->method = flags[0], g->reference = flags[1], g->knows_interaction = flags[2];
    g->rest_unknown = flags[3], g->exact_fit = flags[4], g->used = flags[5];
    g->full = flags[6], g->needed = flags[7], g->has_rows = flags[8];
    for (int64_t k = 0; k < g->rows.count; k++)
        within(r, "row/tangent_of", g->rows.tangent_of + k, 1, -1, g->rows.tangents);
    if ((g->has_composition = exists(r, "axes/vertex")))
        read_composition(r, &g->composition, &g->fit);
    if ((g->has_kriging = exists(r, "kriging/x"))) read_kriging(r, "kriging", &g->kriging, share);
    if ((g->has_missed = exists(r, "missed/x"))) read_kriging(r, "missed", &g->missed, share);
    if (g->has_kriging) each_by_one(r, g, &g->kriging);
    if (g->has_missed) each_by_one(r, g, &g->missed);
    within(r, "flags", flags, 1, 0, WB_METHODS);
    if (g->used && !g->has_composition && !g->has_kriging && !g->exact_fit) fail(r, "flags");
    /* The reference of errors: none, the kriging, or the axes with or without what they miss. */
    int mode = g->reference, missed = mode == (WB_REF_ADDITIVE | WB_REF_MISSED);
    if (mode && mode != WB_REF_KRIGING && mode != WB_REF_ADDITIVE && !missed) fail(r, "flags");
    if ((mode == WB_REF_KRIGING && !g->has_kriging) || (missed && !g->has_missed)
        || (mode & WB_REF_ADDITIVE && !g->has_composition))
        fail(r, "flags");
}

/* The directory's and the JSON block's own place; 0 if they are not in the file. */
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

static int read_all(wb_table *t, char *why, size_t most) {
    reader r = {t, "", ""};
    char prefix[16];
    if (!read_frame(t)) return snprintf(why, most, "the table's directory is damaged"), 0;
    read_space(&r);
    if (!*r.bad) read_solver(&r);
    if (!*r.bad) {
        size_t groups = (size_t)t->groups;
        t->group = calloc(groups, sizeof *t->group);
        t->share = calloc(2 * groups * (size_t)t->outputs, sizeof *t->share);
        if (!t->group || !t->share) return snprintf(why, most, "no memory"), 0;
    }
    wb_share *share = t->share;
    for (int i = 0; !*r.bad && i < t->groups; i++) {
        snprintf(prefix, sizeof prefix, "g%d/", i);
        r.group = prefix;
        read_group(&r, &t->group[i], &share);
    }
    if (!*r.bad) return 1;
    return snprintf(why, most, "the table's array %s is missing or of another shape", r.bad), 0;
}

static wb_table *make(const unsigned char *bytes, size_t size, size_t mapped, char *why,
                      size_t most) {
    wb_table *t = calloc(1, sizeof *t);
    if (!t) return snprintf(why, most, "no memory"), NULL;
    t->bytes = bytes, t->size = size, t->mapped = mapped;
    if (read_all(t, why, most)) return t;
    wb_close(t);
    return NULL;
}

wb_table *wb_open(const char *path, char *why, size_t most) {
    size_t size = 0;
    const unsigned char *bytes = wb_map(path, &size, why, most);
    return bytes ? make(bytes, size, size, why, most) : NULL;
}

wb_table *wb_open_bytes(const void *bytes, size_t count, char *why, size_t most) {
    if ((uintptr_t)bytes % 8)
        return snprintf(why, most, "the bytes of the table are not aligned to 8 bytes"), NULL;
    return wb_check_bytes(bytes, count, why, most) ? make(bytes, count, 0, why, most) : NULL;
}

wb_table *wb_open_checked(const void *bytes, size_t count, char *why, size_t most) {
    return make(bytes, count, 0, why, most);
}

void wb_close(wb_table *t) {
    if (!t) return;
    wb_unmap(t);
    free(t->share);
    free(t->group);
    free(t);
}

int wb_inputs(const wb_table *t) { return t->inputs; }
int wb_outputs(const wb_table *t) { return t->outputs; }
const char *wb_json(const wb_table *t) { return t->json; }
