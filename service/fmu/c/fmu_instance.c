/* FMI 2.0: instances, their modes and their states. MIT license, as all of wrenchbook. */
#include "fmu.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MAX_PATH_LENGTH = 4096 };

fmi2Status fmu_say(fmu_instance *m, fmi2Status status, const char *text) {
    char plain[MAX_PATH_LENGTH]; /* the message is a format, and not every tool fills in what it names */
    size_t at = 0;
    for (; *text && at + 2 < sizeof plain; text++) {
        if (*text == '%') plain[at++] = '%';
        plain[at++] = *text;
    }
    plain[at] = 0;
    if (m->callbacks.logger)
        m->callbacks.logger(m->callbacks.componentEnvironment, m->name, status,
                            status == fmi2Warning ? "logStatusWarning" : "logStatusError", plain);
    return status;
}

int fmu_allowed(fmu_instance *m, const char *call, int modes) {
    char text[128];
    if (!m) return 0;
    if (m->state.mode & modes) return 1;
    snprintf(text, sizeof text, "%s is not allowed now%s", call,
             m->state.mode == TERMINATED ? ": the instance is terminated; reset it first" : "");
    fmu_say(m, fmi2Error, text);
    return 0;
}

void fmu_ask(fmu_instance *m, const double *wrench, wb_reply *reply) {
    double tolerance[WB_MAX];
    wb_options options = {m->method, tolerance, 0};
    for (int q = 0; q < m->outputs; q++) {
        double limit = m->state.tolerance[q % AN_INTERFACE / TRANSLATIONS];
        tolerance[q] = limit > 0 ? limit : NAN; /* zero: the component's own */
    }
    wb_answer(m->table, &options, wrench, reply, m->scratch);
}

const wb_reply *fmu_answered(fmu_instance *m) {
    if (!m->answered) {
        fmu_ask(m, m->state.wrench, &m->reply);
        m->answered = 1;
    }
    return &m->reply;
}

const double *fmu_derived(fmu_instance *m) {
    if (!m->derived) {
        wb_options options = {m->method, NULL, 0};
        wb_work work = wb_work_of(m->table, m->scratch);
        wb_reply_derivative(m->table, &options, &work, fmu_answered(m), m->derivative);
        m->derived = 1;
    }
    return m->derivative;
}

void fmu_reset(fmu_instance *m) {
    memset(&m->state, 0, sizeof m->state);
    memcpy(m->state.mark, "WBSTATE1", 8);
    memcpy(m->state.guid, m->guid, WB_GUID);
    memcpy(m->state.wrench, m->start, sizeof m->state.wrench);
    m->state.mode = INSTANTIATED;
    m->answered = m->derived = 0;
}

static int digit(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    return c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The path of a file in the folder that a file URI (RFC 8089) names; 0 if it names none. */
static int path_of(const char *uri, const char *file, char *path) {
    size_t at = 0;
    if (!uri || strncmp(uri, "file:", 5)) return 0;
    uri += 5;
    if (!strncmp(uri, "//", 2)) {
        uri += 2;
        if (!strncmp(uri, "localhost/", 10)) uri += 9;
    }
    if (*uri != '/') return 0;
    if (strlen(uri) > 2 && uri[2] == ':') uri++; /* a drive: /C:/... */
    for (; *uri; uri++, at++) {
        if (at + strlen(file) + 3 > MAX_PATH_LENGTH) return 0;
        if (*uri == '%' && digit(uri[1]) >= 0 && digit(uri[2]) >= 0) {
            path[at] = (char)(16 * digit(uri[1]) + digit(uri[2]));
            uri += 2;
        } else {
            path[at] = *uri;
        }
    }
    if (at && path[at - 1] != '/') path[at++] = '/';
    strcpy(path + at, file);
    return 1;
}

/* Read the GUID, the method and the inputs' start values, a line each; 0 if the first two are not
 * there. */
static int read_model(fmu_instance *m, const char *path) {
    FILE *file = fopen(path, "rb");
    int read = file && fscanf(file, "%39s %d", m->guid, &m->method) == 2;
    for (int k = 0; read && k < WB_MAX; k++)
        if (fscanf(file, "%lf", m->start + k) != 1) break;
    if (file) fclose(file);
    return read;
}

/* Take the numbers of inputs and outputs from the table, and the value references from them. */
static void number_variables(fmu_instance *m) {
    m->inputs = wb_inputs(m->table), m->outputs = wb_outputs(m->table);
    m->vr.output = (fmi2ValueReference)m->inputs;
    m->vr.error = m->vr.output + (fmi2ValueReference)m->outputs;
    m->vr.coverage = m->vr.error + (fmi2ValueReference)m->outputs;
    m->vr.tolerance = m->vr.coverage + 1;
    m->vr.within = m->vr.tolerance + 2;
}

/* Map the table of an instance; 0 after a report if that cannot be done. */
static int open_table(fmu_instance *m, fmi2String guid, fmi2String location) {
    char path[MAX_PATH_LENGTH], why[MAX_PATH_LENGTH + 128];
    if (!path_of(location, "model.txt", path)) {
        snprintf(why, sizeof why, "fmuResourceLocation must be a file URI such as file:///tmp/plate"
                 "/resources, not %.200s", location ? location : "nothing");
        return fmu_say(m, fmi2Error, why), 0;
    }
    if (!read_model(m, path)) {
        snprintf(why, sizeof why, "cannot read %s: unpack the FMU again", path);
        return fmu_say(m, fmi2Error, why), 0;
    }
    if (!guid || strcmp(guid, m->guid)) {
        snprintf(why, sizeof why, "the GUID %.60s is not that of the table in %.200s, which is %s",
                 guid ? guid : "(none)", path, m->guid);
        return fmu_say(m, fmi2Error, why), 0;
    }
    path_of(location, "table.wbt", path);
    m->table = wb_open(path, why, sizeof why);
    if (!m->table) return fmu_say(m, fmi2Error, why), 0;
    number_variables(m);
    m->scratch = m->callbacks.allocateMemory(1, wb_scratch(m->table));
    m->derivative = m->callbacks.allocateMemory((size_t)m->inputs * m->outputs, sizeof(double));
    if (m->scratch && m->derivative) return 1;
    return fmu_say(m, fmi2Error, "no memory for the scratch"), 0;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean logging) {
    (void)visible, (void)logging; /* mistakes are reported in any case; there is nothing else */
    if (!functions || !functions->allocateMemory || !functions->freeMemory) return NULL;
    fmu_instance *m = functions->allocateMemory(1, sizeof *m);
    if (!m) return NULL;
    memset(m, 0, sizeof *m);
    m->callbacks = *functions, m->type = type;
    name = name && *name ? name : "wrenchbook";
    m->name = functions->allocateMemory(strlen(name) + 1, 1);
    if (m->name) strcpy(m->name, name);
    if (!m->name || !open_table(m, guid, location)) {
        fmi2FreeInstance(m);
        return NULL;
    }
    fmu_reset(m);
    return m;
}

void fmi2FreeInstance(fmi2Component c) {
    fmu_instance *m = c;
    if (!m) return;
    fmi2CallbackFreeMemory free_ = m->callbacks.freeMemory;
    if (m->scratch) free_(m->scratch);
    if (m->derivative) free_(m->derivative);
    wb_close(m->table);
    if (m->name) free_(m->name);
    free_(m);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean has_tolerance, fmi2Real tolerance,
                               fmi2Real start, fmi2Boolean has_stop, fmi2Real stop) {
    fmu_instance *m = c;
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop; /* nothing is integrated */
    if (!fmu_allowed(m, "fmi2SetupExperiment", INSTANTIATED)) return fmi2Error;
    m->state.time = start;
    return fmi2OK;
}

static fmi2Status go(fmu_instance *m, const char *call, int from, int to) {
    if (!fmu_allowed(m, call, from)) return fmi2Error;
    m->state.mode = to;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c) {
    return go(c, "fmi2EnterInitializationMode", INSTANTIATED, INITIALIZATION);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) {
    fmu_instance *m = c;
    int to = m && m->type == fmi2CoSimulation ? STEP : EVENT;
    return go(m, "fmi2ExitInitializationMode", INITIALIZATION, to);
}

fmi2Status fmi2Terminate(fmi2Component c) {
    return go(c, "fmi2Terminate", EVENT | CONTINUOUS | STEP, TERMINATED);
}

fmi2Status fmi2Reset(fmi2Component c) {
    if (!c) return fmi2Error;
    fmu_reset(c);
    return fmi2OK;
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *out) {
    fmu_instance *m = c;
    if (!m || !out) return fmi2Error;
    if (!*out && !(*out = m->callbacks.allocateMemory(1, sizeof m->state)))
        return fmu_say(m, fmi2Error, "no memory for a state");
    memcpy(*out, &m->state, sizeof m->state);
    return fmi2OK;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate in) {
    fmu_instance *m = c;
    if (!m || !in) return fmi2Error;
    memcpy(&m->state, in, sizeof m->state);
    m->answered = m->derived = 0;
    return fmi2OK;
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    fmu_instance *m = c;
    if (!m || !state) return fmi2Error;
    if (*state) m->callbacks.freeMemory(*state);
    *state = NULL;
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate state, size_t *size) {
    if (!c || !state || !size) return fmi2Error;
    *size = sizeof(fmu_state);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[],
                                 size_t size) {
    if (!c || !state || !bytes) return fmi2Error;
    if (size < sizeof(fmu_state)) return fmu_say(c, fmi2Error, "the state needs more bytes");
    memcpy(bytes, state, sizeof(fmu_state));
    return fmi2OK;
}

/* Whether bytes are a state of this very table that an instance can be in. */
static int is_state(const fmu_instance *m, const fmu_state *s) {
    int modes = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED;
    if (memcmp(s->mark, "WBSTATE1", 8) || memcmp(s->guid, m->guid, WB_GUID)) return 0;
    for (int k = 0; k < m->inputs; k++)
        if (!isfinite(s->wrench[k])) return 0;
    return s->mode > 0 && (s->mode & modes) && !(s->mode & (s->mode - 1))
           && s->tolerance[0] >= 0 && s->tolerance[1] >= 0;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size,
                                   fmi2FMUstate *out) {
    fmu_instance *m = c;
    fmu_state state;
    if (!m || !bytes || !out) return fmi2Error;
    if (size == sizeof state) memcpy(&state, bytes, sizeof state);
    if (size != sizeof state || !is_state(m, &state))
        return fmu_say(m, fmi2Error, "these bytes are no state of this FMU");
    if (!*out && !(*out = m->callbacks.allocateMemory(1, sizeof state)))
        return fmu_say(m, fmi2Error, "no memory for a state");
    memcpy(*out, &state, sizeof state);
    return fmi2OK;
}
