/* FMI 2.0: stepping and events. The outputs follow the inputs at once: there is nothing to
 * integrate. MIT license, as all of wrenchbook. */
#include "fmu.h"

#include <math.h>
#include <string.h>

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t count,
                               const fmi2String categories[]) {
    (void)on, (void)count, (void)categories; /* mistakes are always reported */
    return c ? fmi2OK : fmi2Error;
}

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real time, fmi2Real step, fmi2Boolean no_return) {
    fmu_instance *m = c;
    (void)no_return;
    if (!fmu_allowed(m, "fmi2DoStep", STEP)) return fmi2Error;
    if (!(isfinite(time) && isfinite(step) && step >= 0))
        return fmu_say(m, fmi2Error, "fmi2DoStep: time and step must be finite, the step not below 0");
    m->state.time = time + step;
    return fmi2OK;
}

fmi2Status fmi2CancelStep(fmi2Component c) {
    return c ? fmu_say(c, fmi2Error, "there is no step to cancel: steps end at once") : fmi2Error;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[]) {
    (void)vr, (void)nvr, (void)order, (void)value;
    return c ? fmu_say(c, fmi2Error, "inputs are not interpolated (canInterpolateInputs is false)")
             : fmi2Error;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[]) {
    (void)vr, (void)nvr, (void)order, (void)value;
    return c ? fmu_say(c, fmi2Error, "outputs have no time derivatives (maxOutputDerivativeOrder 0)")
             : fmi2Error;
}

static fmi2Status no_status(fmi2Component c) {
    return c ? fmu_say(c, fmi2Discard, "steps are not asynchronous: there is no such status")
             : fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Status *value) {
    (void)kind, (void)value;
    return no_status(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    fmu_instance *m = c;
    if (!m || kind != fmi2LastSuccessfulTime) return no_status(c);
    *value = m->state.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value) {
    (void)kind, (void)value;
    return no_status(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    if (!c || kind != fmi2Terminated) return no_status(c);
    *value = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind kind, fmi2String *value) {
    (void)kind, (void)value;
    return no_status(c);
}

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2EnterEventMode", EVENT | CONTINUOUS)) return fmi2Error;
    m->state.mode = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2NewDiscreteStates", EVENT)) return fmi2Error;
    memset(info, 0, sizeof *info);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2EnterContinuousTimeMode", EVENT)) return fmi2Error;
    m->state.event_coverage = fmu_answered(m)->coverage;
    m->state.event_within = fmu_answered(m)->within;
    m->state.mode = CONTINUOUS;
    return fmi2OK;
}

/* In continuous time `coverage` and `within_tolerance` keep the values of the last event; a step at
 * whose end the table gives other values asks for an event, which changes them. */
fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean no_return, fmi2Boolean *event,
                                       fmi2Boolean *terminate) {
    fmu_instance *m = c;
    (void)no_return;
    if (!fmu_allowed(m, "fmi2CompletedIntegratorStep", CONTINUOUS)) return fmi2Error;
    *event = fmu_answered(m)->coverage != m->state.event_coverage ||
             fmu_answered(m)->within != m->state.event_within;
    *terminate = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2SetTime", EVENT | CONTINUOUS)) return fmi2Error;
    if (!isfinite(time)) return fmu_say(m, fmi2Error, "fmi2SetTime: the time must be finite");
    m->state.time = time;
    return fmi2OK;
}

/* There are no states and no event indicators. */
static fmi2Status none(fmi2Component c, size_t count) {
    if (!c) return fmi2Error;
    return count ? fmu_say(c, fmi2Error, "there are no continuous states and no event indicators")
                 : fmi2OK;
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx) {
    (void)x;
    return none(c, nx);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx) {
    (void)derivatives;
    return none(c, nx);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real indicators[], size_t ni) {
    (void)indicators;
    return none(c, ni);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx) {
    (void)x;
    return none(c, nx);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real nominal[], size_t nx) {
    (void)nominal;
    return none(c, nx);
}
