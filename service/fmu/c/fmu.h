/* One instance of the FMU. MIT license, as all of wrenchbook.
 *
 * An instance owns its mapped table, its scratch and its state; there is nothing global that
 * changes, so any number of instances may run in as many threads (one thread an instance at a time,
 * as FMI 2.0 has it).
 */
#ifndef WB_FMU_H
#define WB_FMU_H

#include "fmi2Functions.h"
#include "wb_internal.h"

#define WB_GUID 40 /* bytes of a GUID in braces, with the final zero, and one to spare */

/* Outputs of an interface: translations, then rotations. */
enum { TRANSLATIONS = 3, AN_INTERFACE = 6 };

/* First value reference of each kind of variable; those of the inputs begin with 0.
 * service/fmu/description.py writes the same into modelDescription.xml. */
typedef struct {
    fmi2ValueReference output, error, coverage, tolerance, within;
} fmu_references;

enum { INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32,
       FAILED = 64 };

/* All that a state is: what fmi2GetFMUstate keeps and fmi2SerializeFMUstate writes. */
typedef struct {
    char mark[8], guid[WB_GUID];
    double wrench[WB_MAX], tolerance[2], time;
    int32_t mode, event_coverage, event_within;
} fmu_state;

typedef struct {
    fmi2CallbackFunctions callbacks;
    fmi2Type type;
    char *name;
    wb_table *table;
    void *scratch;
    int inputs, outputs, method;
    fmu_references vr;
    char guid[WB_GUID]; /* of the table and the method: resources/model.txt */
    double start[WB_MAX]; /* inputs without an effect: no load, the reference temperature */
    fmu_state state;
    wb_reply reply;
    double *derivative; /* outputs x inputs */
    int warned;
    int answered, derived; /* whether answer and derivative are those of the state */
} fmu_instance;

/* Report to the simulator; returns the status. */
fmi2Status fmu_say(fmu_instance *m, fmi2Status status, const char *text);
/* Whether a call is allowed in this mode; reports if it is not. */
int fmu_allowed(fmu_instance *m, const char *call, int modes);
const wb_reply *fmu_answered(fmu_instance *m);
const double *fmu_derived(fmu_instance *m);
void fmu_ask(fmu_instance *m, const double *wrench, wb_reply *reply);
void fmu_reset(fmu_instance *m);

#endif
