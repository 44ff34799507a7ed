/* How many evaluations an FMU makes a second, asked through its FMI 2.0 functions.
 *
 *     rate LIBRARY RESOURCES_URI GUID WRENCHES SECONDS
 *
 * WRENCHES is a file of doubles, six each. An evaluation is fmi2SetReal of six loads, fmi2GetReal of
 * twelve outputs and fmi2GetInteger of the coverage. Prints evaluations and processor seconds.
 */
#include "fmi2Functions.h"

#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <time.h>

static void say(fmi2ComponentEnvironment e, fmi2String name, fmi2Status status, fmi2String category,
                fmi2String text, ...) {
    va_list rest;
    (void)e, (void)status, (void)category;
    va_start(rest, text);
    fprintf(stderr, "%s: ", name);
    vfprintf(stderr, text, rest);
    fprintf(stderr, "\n");
    va_end(rest);
}

#define FIND(name) name##TYPE *p_##name = (name##TYPE *)dlsym(library, #name)

int main(int argc, char **argv) {
    static double wrench[60000];
    const fmi2ValueReference in[6] = {0, 1, 2, 3, 4, 5}, flag[1] = {18};
    const fmi2ValueReference out[12] = {6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17};
    fmi2CallbackFunctions callbacks = {say, calloc, free, NULL, NULL};
    double told[12], sum = 0.0, most;
    int coverage[1];
    long done = 0;
    void *library = argc == 6 ? dlopen(argv[1], RTLD_NOW) : NULL;
    FILE *file = library ? fopen(argv[4], "rb") : NULL;
    if (!file) return 2;
    size_t count = fread(wrench, 48, 10000, file);
    fclose(file);
    FIND(fmi2Instantiate); FIND(fmi2SetupExperiment); FIND(fmi2EnterInitializationMode);
    FIND(fmi2ExitInitializationMode); FIND(fmi2SetReal); FIND(fmi2GetReal); FIND(fmi2GetInteger);
    FIND(fmi2FreeInstance);
    fmi2Component c = p_fmi2Instantiate("rate", fmi2CoSimulation, argv[3], argv[2], &callbacks, 0, 0);
    if (!c || p_fmi2SetupExperiment(c, 0, 0, 0, 0, 0) || p_fmi2EnterInitializationMode(c)
        || p_fmi2ExitInitializationMode(c)) return 3;
    sscanf(argv[5], "%lf", &most);
    clock_t start = clock();
    while ((double)(clock() - start) < most * CLOCKS_PER_SEC)
        for (size_t i = 0; i < count; i++, done++) {
            if (p_fmi2SetReal(c, in, 6, wrench + 6 * i) || p_fmi2GetReal(c, out, 12, told)
                || p_fmi2GetInteger(c, flag, 1, coverage)) return 4;
            sum += told[0] + coverage[0];
        }
    printf("%ld %.9g %.17g\n", done, (double)(clock() - start) / CLOCKS_PER_SEC, sum);
    p_fmi2FreeInstance(c);
    return 0;
}
