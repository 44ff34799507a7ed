/* Answer from a table: example TABLE.wbt, then its loads, such as Fx Fy Fz Mx My Mz */
#include "wrenchbook.h"
#include <stdio.h>
#include <stdlib.h>
static const char *COVERAGE[] = {"covered", "thin", "outside"};
static const char *METHOD[] = {"griddata", "additive", "kriging", "linear", "row", "estimate"};
int main(int count, char **words) {
    char why[256] = "give a table and its loads";
    double loads[WB_MAX];
    wb_reply reply;
    wb_table *table = count > 1 ? wb_open(words[1], why, sizeof why) : NULL;
    if (!table || count != 2 + wb_inputs(table))
        return fprintf(stderr, "%s (loads: %d)\n", why, table ? wb_inputs(table) : 0), 1;
    for (int k = 0; k < wb_inputs(table); k++) {
        char *end = words[2 + k];
        loads[k] = strtod(words[2 + k], &end);
        if (*end || end == words[2 + k]) return fprintf(stderr, "'%s' is not a number\n", words[2 + k]), 1;
    }
    void *scratch = malloc(wb_scratch(table)); /* one for each thread, for all its answers */
    if (!scratch || wb_answer(table, NULL, loads, &reply, scratch)) return 2;
    printf("%s %s\n", COVERAGE[reply.coverage], METHOD[reply.method]);
    for (int k = 0; k < wb_outputs(table); k++)
        printf("%.17g %.17g\n", reply.outputs[k], reply.error[k]);
    free(scratch);
    wb_close(table);
}
