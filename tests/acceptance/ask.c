/* All that a table says of wrenches, by every call of wrenchbook.h: program TABLE < asked > said.
 *
 * Asked: method and number of wrenches (int32), six tolerances and the wrenches (double). Said: of
 * each wrench its wb_reply and du/dw (36); then of all at once outputs and errors (n, 6), du/dw
 * (n, 36) and coverage (n bytes).
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
    double tolerance[6], slope[36];
    wb_reply reply;
    wb_table *table = count == 2 ? wb_open(words[1], why, sizeof why) : NULL;
    if (!table) return fprintf(stderr, "%s\n", count == 2 ? why : "which table?"), 1;
    take(head, sizeof *head, 2);
    take(tolerance, sizeof *tolerance, 6);
    size_t n = (size_t)head[1];
    wb_options options = {head[0], tolerance};
    double *asked = malloc(n * 6 * sizeof *asked), *many = malloc(n * 48 * sizeof *many);
    unsigned char *coverage = malloc(n);
    void *scratch = malloc(wb_scratch(table));
    if (!asked || !many || !coverage || !scratch) return 2;
    take(asked, 6 * sizeof *asked, n);
    for (size_t i = 0; i < n; i++) {
        need(wb_answer(table, &options, asked + 6 * i, &reply, scratch));
        need(wb_derivative(table, &options, asked + 6 * i, slope, scratch));
        tell(&reply, sizeof reply, 1);
        tell(slope, sizeof *slope, 36);
    }
    need(wb_answer_many(table, &options, n, asked, many, many + 6 * n, coverage, 2));
    need(wb_derivative_many(table, &options, n, asked, many + 12 * n, 2));
    tell(many, 48 * sizeof *many, n);
    tell(coverage, 1, n);
    return 0;
}
