/* All that a table says of wrenches, by every call of wrenchbook.h: program TABLE < asked > said.
 *
 * Asked: method and number of wrenches (int32), m tolerances and the wrenches (double). Said: of
 * each wrench its wb_reply and du/dw (m n); then of all at once outputs and errors (k, m), du/dw
 * (k, m n) and coverage (k bytes). The table has n inputs and m outputs.
 */
#include "wrenchbook.h"
#include <stdio.h>
#include <stdlib.h>

static void take(void *to, size_t size, size_t count) {
    if (fread(to, size, count, stdin) != count) exit(3);
}

static void tell(const void *from, size_t size, size_t count) {
    if (fwrite(from, size, count, stdout) != count) exit(4);
}

static void need(int wrong) {
    if (wrong) exit(10 + wrong);
}

int main(int count, char **words) {
    char why[256];
    int32_t head[2];
    double tolerance[WB_MAX];
    wb_reply reply;
    wb_table *table = count == 2 ? wb_open(words[1], why, sizeof why) : NULL;
    if (!table) return fprintf(stderr, "%s\n", count == 2 ? why : "which table?"), 1;
    size_t n = (size_t)wb_inputs(table), m = (size_t)wb_outputs(table);
    take(head, sizeof *head, 2);
    take(tolerance, sizeof *tolerance, m);
    size_t k = (size_t)head[1];
    wb_options options = {.method = head[0], .tolerance = tolerance};
    double *asked = malloc(k * n * sizeof *asked), *slope = malloc(m * n * sizeof *slope);
    double *many = malloc(k * m * (2 + n) * sizeof *many);
    unsigned char *coverage = malloc(k);
    void *scratch = malloc(wb_scratch(table));
    if (!asked || !slope || !many || !coverage || !scratch) return 2;
    take(asked, n * sizeof *asked, k);
    for (size_t i = 0; i < k; i++) {
        need(wb_answer(table, &options, asked + n * i, &reply, scratch));
        need(wb_derivative(table, &options, asked + n * i, slope, scratch));
        tell(&reply, sizeof reply, 1);
        tell(slope, sizeof *slope, m * n);
    }
    need(wb_answer_many(table, &options, k, asked, many, many + m * k, coverage, 2));
    need(wb_derivative_many(table, &options, k, asked, many + 2 * m * k, 2));
    tell(many, m * (2 + n) * sizeof *many, k);
    tell(coverage, 1, k);
    return 0;
}
