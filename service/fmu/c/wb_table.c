/* Read a table's file: service/fmu/packing.py writes it. MIT license, as all of wrenchbook.
 *
 * The file: 8 bytes "WBFMU001", a 64-bit FNV-1a checksum of all that follows it, the GUID (40
 * bytes), then arrays, each with its kind (0: float64, 1: int32) and its count as int64, padded to
 * 8 bytes; all in the machine's own order of bytes, little-endian. Counts are checked against what
 * they must be, and every index an array holds against what it points into, so that a damaged or a
 * stranger's file is refused and never read beyond its end.
 */
#include "wb_table.h"

#include <stdio.h>
#include <string.h>

static const int64_t MOST_BYTES = 256 * 1024 * 1024; /* packing.py states and keeps to it */

typedef struct {
    const unsigned char *at, *end;
    int bad;
} reader;

/* The next array, of a kind; `count` elements, or any number if it is negative. */
static const void *next(reader *r, int64_t kind, int64_t *count) {
    int64_t head[2], bytes;
    if (r->bad || r->end - r->at < 16) return r->bad = 1, NULL;
    memcpy(head, r->at, 16);
    if (head[0] != kind || head[1] < 0 || head[1] > MOST_BYTES) return r->bad = 1, NULL;
    if (*count >= 0 && head[1] != *count) return r->bad = 1, NULL;
    bytes = head[1] * (kind == 0 ? 8 : 4);
    bytes += (8 - bytes % 8) % 8;
    if (r->end - r->at - 16 < bytes) return r->bad = 1, NULL;
    const void *found = r->at + 16;
    r->at += 16 + bytes;
    *count = head[1];
    return found;
}

static const double *doubles(reader *r, int64_t count) { return next(r, 0, &count); }
static const int32_t *ints(reader *r, int64_t count) { return next(r, 1, &count); }

/* Refuse an array that points out of what it points into. */
static void within(reader *r, const int32_t *values, int64_t count, int64_t low, int64_t high) {
    for (int64_t k = 0; !r->bad && k < count; k++) r->bad |= values[k] < low || values[k] >= high;
}

static int32_t one(reader *r, int32_t low, int32_t high) {
    const int32_t *value = ints(r, 1);
    if (value) within(r, value, 1, low, (int64_t)high + 1);
    return r->bad ? low : *value;
}

static void read_cut(reader *r, wb_cut *cut) {
    cut->present = one(r, 0, 1);
    if (!cut->present) return;
    cut->stretches = one(r, 0, INT32_MAX - 1);
    cut->scale = doubles(r, 1);
    cut->stations = doubles(r, cut->stretches ? cut->stretches + 1 : 0);
    cut->pieces = doubles(r, 30 * (int64_t)cut->stretches);
    cut->rest = doubles(r, 12 * (int64_t)cut->stretches);
    cut->state = ints(r, cut->stretches);
}

static void read_fit(reader *r, wb_fit *fit) {
    fit->matrix = doubles(r, 36);
    fit->bar = doubles(r, 6);
    fit->known = ints(r, 6);
}

/* Check one axis' grid and simplices: all that a walk follows. */
static void check_axis(reader *r, const wb_composition *c, int axis, int64_t cells) {
    const int32_t *own = c->ints + WB_AXIS_INTS * axis;
    int64_t size = 1, low = c->simplex_first[axis], high = c->simplex_first[axis + 1];
    within(r, own, 1, -1, 4);
    within(r, own + WB_FIRST_CELL, 1, 0, cells + 1);
    within(r, c->simplex_first + axis, 2, 0, c->simplices + 1);
    if (r->bad || own[0] < 0) return;
    r->bad |= high <= low;
    for (int k = 0; k < 3; k++) {
        r->bad |= own[WB_CELLS + k] < 1 || own[WB_CELLS + k] > cells;
        size *= own[WB_CELLS + k] < 1 ? 1 : own[WB_CELLS + k];
        r->bad |= own[WB_FIRST_CELL] + size > cells;
        if (r->bad) return;
    }
    within(r, c->grid + own[WB_FIRST_CELL], size, low, high);
    for (int64_t s = low; !r->bad && s < high; s++) {
        const int32_t *simplex = c->simplex + WB_SIMPLEX * s;
        within(r, simplex, 4, 0, c->points);
        within(r, simplex + WB_NEIGHBOUR, 4, -1, high);
    }
}

static void read_composition(reader *r, wb_composition *c) {
    int64_t cells = -1, facets;
    c->points = one(r, 0, INT32_MAX - 1);
    c->simplices = one(r, 0, INT32_MAX - 1);
    c->vertex = doubles(r, WB_VERTEX * c->points);
    c->place = doubles(r, 3 * c->points);
    c->slopes = doubles(r, 12 * c->points);
    c->maps = doubles(r, WB_MAP * c->simplices);
    c->simplex = ints(r, WB_SIMPLEX * c->simplices);
    c->grid = next(r, 1, &cells);
    c->floats = doubles(r, 3 * WB_AXIS_FLOATS);
    c->ints = ints(r, 3 * WB_AXIS_INTS);
    c->simplex_first = ints(r, 4);
    c->facet_first = ints(r, 4);
    facets = r->bad ? 0 : c->facet_first[3];
    c->facets = ints(r, 4 * facets);
    c->rest_point = doubles(r, 12);
    read_fit(r, &c->fit);
    for (int m = 0; m < 3; m++)
        for (int k = 0; k < 2; k++) read_cut(r, &c->cuts[m][k]);
    for (int axis = 0; !r->bad && axis < 3; axis++) check_axis(r, c, axis, cells);
    if (r->bad) return;
    within(r, c->facet_first, 4, 0, facets + 1);
    for (int64_t f = 0; !r->bad && f < facets; f++) {
        within(r, c->facets + 4 * f, 3, 0, c->points);
        within(r, c->facets + 4 * f + 3, 1, 0, c->simplices);
    }
}

static void read_share(reader *r, wb_share *share, int64_t rows) {
    int64_t e = share->equations = one(r, 1, 100000);
    share->outputs = ints(r, 6);
    share->places = ints(r, rows * e);
    share->reduce = doubles(r, rows * e * (e + 1) / 2);
    share->unsettled = doubles(r, rows * e * 7);
    share->least = doubles(r, rows);
    share->mean_covariance = doubles(r, 49);
    share->levels = one(r, 1, 1000);
    share->sigma = doubles(r, share->levels + 1);
    share->factors = doubles(r, 6 * (int64_t)share->levels);
    if (!r->bad) within(r, share->places, rows * e, 0, 7 * rows);
}

static void read_kriging(reader *r, wb_kriging *k, wb_share **share) {
    int64_t n = k->rows = one(r, 1, 1000000);
    k->x = doubles(r, 6 * n);
    k->terms = doubles(r, 28);
    k->weights = doubles(r, 42 * n);
    k->coefficients = doubles(r, 42);
    k->scales = doubles(r, 36);
    k->floor = doubles(r, 1);
    k->tangent = doubles(r, 36);
    k->span = doubles(r, 12);
    k->shares = one(r, 1, 6);
    k->share = *share;
    for (int s = 0; !r->bad && s < k->shares; s++) read_share(r, (*share)++, n);
}

/* What rows say at and beside their own wrenches: `ExactRows`. */
static void read_rows(reader *r, wb_group *g) {
    g->rows = one(r, 0, INT32_MAX - 1);
    g->row_key = doubles(r, g->rows);
    g->row_rate = doubles(r, 6);
    g->steepest = doubles(r, 6);
    g->row_number = ints(r, g->rows);
    g->row_wrench = doubles(r, 6 * (int64_t)g->rows);
    g->row_displacement = doubles(r, 6 * (int64_t)g->rows);
    g->row_bar = doubles(r, 6 * (int64_t)g->rows);
    g->row_tangent = ints(r, g->rows);
    g->tangents = one(r, 0, g->rows);
    g->tangent = doubles(r, 36 * (int64_t)g->tangents);
    for (int row = 0; !r->bad && row < g->rows; row++)
        r->bad |= g->row_tangent[row] < -1 || g->row_tangent[row] >= g->tangents;
}

static void read_group(reader *r, wb_group *g, wb_share **share) {
    g->outputs = ints(r, 6);
    g->method = one(r, WB_GRIDDATA, WB_NEAREST);
    g->reference = one(r, WB_NO_REFERENCE, WB_ITSELF);
    g->knows_interaction = one(r, 0, 1);
    g->rest_unknown = one(r, 0, 1);
    g->exact_fit = one(r, 0, 1);
    g->low = doubles(r, 6);
    g->high = doubles(r, 6);
    g->small = doubles(r, 6);
    g->allowed = doubles(r, 6);
    g->scale = doubles(r, 6);
    read_rows(r, g);
    if ((g->has_composition = one(r, 0, 1))) read_composition(r, &g->composition);
    if ((g->has_kriging = one(r, 0, 1))) read_kriging(r, &g->kriging, share);
    if ((g->has_fit = one(r, 0, 1))) read_fit(r, &g->fit);
    g->nearest_rows = one(r, 0, INT32_MAX - 1);
    g->nearest_wrench = doubles(r, 6 * (int64_t)g->nearest_rows);
    g->nearest_displacement = doubles(r, 6 * (int64_t)g->nearest_rows);
    /* What the method needs must be there. */
    int composes = g->method <= WB_TANGENT || g->reference == WB_BENDS || g->reference == WB_MISSED;
    int kriges = g->method == WB_KRIGING || g->reference >= WB_MISSED;
    r->bad |= (composes && !g->has_composition) || (kriges && !g->has_kriging);
    r->bad |= g->method == WB_LINEAR && !g->has_fit;
    r->bad |= g->method == WB_NEAREST && g->nearest_rows < 1;
    r->bad |= g->reference < 0 && g->method != WB_KRIGING && !(g->method == WB_LINEAR && g->exact_fit);
}

static void read_all(reader *r, wb_table *t) {
    wb_share *share = t->share;
    t->groups = one(r, 1, 6);
    for (int i = 0; !r->bad && i < t->groups; i++) {
        wb_group *g = &t->group[i];
        read_group(r, g, &share);
        if (!g->has_kriging || r->bad) continue;
        if (g->kriging.rows > t->most_rows) t->most_rows = g->kriging.rows;
        for (int s = 0; s < g->kriging.shares; s++)
            if (g->kriging.share[s].equations > t->most_equations)
                t->most_equations = g->kriging.share[s].equations;
    }
    t->mesh = doubles(r, 36), t->bends = doubles(r, 6), t->one_over = doubles(r, 6);
    t->stiffer = doubles(r, 36), t->asks = doubles(r, 1), t->limit = doubles(r, 3);
    r->bad |= r->at != r->end;
}

static uint64_t checksum(const unsigned char *bytes, int64_t count) {
    uint64_t sum = 14695981039346656037u, word;
    for (int64_t k = 0; k + 8 <= count; k += 8) { /* FNV-1a, eight bytes at a time */
        memcpy(&word, bytes + k, 8);
        sum = (sum ^ word) * 1099511628211u;
    }
    return sum;
}

/* The file's bytes, or NULL. */
static unsigned char *load(const char *path, wb_allocate allocate, wb_free free_, int64_t *size,
                           char *why, size_t most) {
    FILE *file = fopen(path, "rb");
    unsigned char *bytes = NULL;
    if (!file) return snprintf(why, most, "cannot open the table %s", path), NULL;
    if (fseek(file, 0, SEEK_END) == 0) *size = ftell(file);
    if (*size < 56 || *size > MOST_BYTES || *size % 8 || fseek(file, 0, SEEK_SET)) {
        snprintf(why, most, "%s is no wrenchbook table: %ld bytes", path, (long)*size);
    } else if (!(bytes = allocate((size_t)*size, 1))) {
        snprintf(why, most, "no memory for the table: %ld bytes", (long)*size);
    } else if (fread(bytes, 1, (size_t)*size, file) != (size_t)*size) {
        snprintf(why, most, "cannot read the table %s", path);
        free_(bytes), bytes = NULL;
    }
    fclose(file);
    return bytes;
}

static int parse(wb_table *t, int64_t size) {
    uint64_t sum;
    reader r = {t->bytes + 16 + WB_GUID, t->bytes + size, 0};
    memcpy(&sum, t->bytes + 8, 8);
    if (memcmp(t->bytes, "WBFMU001", 8) || sum != checksum(t->bytes + 16, size - 16)) return 0;
    memcpy(t->guid, t->bytes + 16, WB_GUID);
    t->guid[WB_GUID - 1] = 0;
    read_all(&r, t);
    return !r.bad;
}

wb_table *wb_table_read(const char *path, wb_allocate allocate, wb_free free_, char *why,
                        size_t most) {
    int64_t size = 0;
    wb_table *t = allocate(1, sizeof *t);
    if (!t) return snprintf(why, most, "no memory"), NULL;
    memset(t, 0, sizeof *t);
    t->group = allocate(6, sizeof *t->group);
    t->share = allocate(36, sizeof *t->share); /* six groups of six outputs at most */
    if (!t->group || !t->share) {
        snprintf(why, most, "no memory");
    } else if ((t->bytes = load(path, allocate, free_, &size, why, most))) {
        memset(t->group, 0, 6 * sizeof *t->group);
        memset(t->share, 0, 36 * sizeof *t->share);
        if (parse(t, size)) return t;
        snprintf(why, most, "the table %s is damaged: export the FMU anew", path);
    }
    wb_table_free(t, free_);
    return NULL;
}

void wb_table_free(wb_table *t, wb_free free_) {
    if (!t) return;
    if (t->bytes) free_(t->bytes);
    if (t->share) free_(t->share);
    if (t->group) free_(t->group);
    free_(t);
}

wb_workspace *wb_workspace_new(const wb_table *t, wb_allocate allocate, wb_free free_) {
    size_t n = (size_t)t->most_rows, e = (size_t)t->most_equations;
    wb_workspace *work = allocate(1, sizeof *work);
    double *all = work ? allocate(15 * n + 2 * e + 1, sizeof(double)) : NULL;
    if (!all) {
        if (work) free_(work);
        return NULL;
    }
    work->across = all, work->apart = all + 7 * n, work->first = all + 13 * n;
    work->second = all + 14 * n, work->chosen = all + 15 * n, work->reduced = all + 15 * n + e;
    return work;
}

void wb_workspace_free(wb_workspace *work, wb_free free_) {
    if (!work) return;
    free_(work->across);
    free_(work);
}
