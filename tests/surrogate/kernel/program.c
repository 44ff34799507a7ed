/* Answer one wrench from a table: program TABLE.wbt Fx Fy Fz Mx My Mz */
#include "wrenchbook.h"
#include <stdio.h>
#include <stdlib.h>

static const char *COVERAGE[] = {"covered", "thin", "outside"};
static const char *METHOD[] = {"griddata", "additive", "tangent", "kriging", "linear", "nearest", "row"};

int main(int count, char **words) {
    char why[256];
    double wrench[6];
    wb_reply reply;
    wb_table *table = count == 8 ? wb_open(words[1], why, sizeof why) : NULL;
    if (!table) return fprintf(stderr, "%s\n", count == 8 ? why : "a table and six loads"), 1;
    for (int k = 0; k < 6; k++) wrench[k] = strtod(words[2 + k], NULL);
    if (wb_answer(table, NULL, wrench, &reply, malloc(wb_scratch(table)))) return 2;
    printf("%s %s\n", COVERAGE[reply.coverage], METHOD[reply.method]);
    for (int k = 0; k < 6; k++) printf("%a %a\n", reply.outputs[k], reply.error[k]);
}
