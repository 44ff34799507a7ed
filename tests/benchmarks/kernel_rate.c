/* Microseconds of processor time a wrench: kernel_rate TABLE.wbt WRENCHES, doubles, six each.
 * Prints those of single answers and of a batch on one thread. */
#include "wrenchbook.h"

#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { MOST = 100000, SINGLE = 20000, REPEATS = 5 };

static double inputs[6 * MOST], outputs[6 * MOST], errors[6 * MOST];
static unsigned char coverage[MOST];

int main(int count, char **words) {
    char why[256];
    wb_table *table = count == 3 ? wb_open(words[1], why, sizeof why) : NULL;
    FILE *file = table ? fopen(words[2], "rb") : NULL;
    wb_reply reply;
    double single = 1e9, batch = 1e9;
    if (!file) return 1;
    size_t n = fread(inputs, 48, MOST, file);
    void *scratch = malloc(wb_scratch(table));
    for (int repeat = 0; repeat < REPEATS; repeat++) {
        clock_t start = clock();
        for (size_t i = 0; i < SINGLE; i++) wb_answer(table, NULL, inputs + 6 * i, &reply, scratch);
        double took = (double)(clock() - start) / CLOCKS_PER_SEC / SINGLE;
        start = clock();
        if (wb_answer_many(table, NULL, n, inputs, outputs, errors, coverage, 1)) return 2;
        double all = (double)(clock() - start) / CLOCKS_PER_SEC / (double)n;
        single = took < single ? took : single, batch = all < batch ? all : batch;
    }
    printf("%.4f %.4f\n", 1e6 * single, 1e6 * batch);
    return 0;
}
