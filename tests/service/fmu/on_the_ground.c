/* A dead load on the column of tests/column.py, by a load cell on the ground: TABLE push force beside.
 *
 * The load hangs `beside`, m, along z from the interface point, and moves and turns with it. The
 * cell's moment is about the undeformed point; less u x F it is about the present one. Says u_z.
 */
#include "wrenchbook.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

int main(int count, char **words) {
    char why[256];
    wb_reply reply;
    double *u = reply.outputs;
    wb_table *table = count == 5 ? wb_open(words[1], why, sizeof why) : NULL;
    if (!table) return fprintf(stderr, "%s\n", count == 5 ? why : "give all four"), 1;
    double push = strtod(words[2], NULL), across = strtod(words[3], NULL), beside = strtod(words[4], NULL);
    void *scratch = malloc(wb_scratch(table));
    double wrench[6] = {-push, 0.0, across, 0.0, 0.0, 0.0};
    for (int k = 0; k < 6; k++) u[k] = 0.0;
    for (int answers = 0; answers < 60; answers++) {
        double x = u[0] + beside * sin(u[4]), z = u[2] + beside * cos(u[4]);
        double read = z * wrench[0] - x * wrench[2];
        wrench[4] = read - (u[2] * wrench[0] - u[0] * wrench[2]);
        if (wb_answer(table, NULL, wrench, &reply, scratch)) return 2;
    }
    printf("%d %.17g\n", reply.coverage, u[2]);
    return 0;
}
