/* FMI 2.0: variables and their derivatives. MIT license, as all of wrenchbook. */
#include "fmu.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const int ANY = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED;
static const int SETTING = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP;
static const double STEP_SHARE = 1e-6; /* of the load range: between its rounding and its kinks */

static fmi2Status no_variable(fmu_instance *m, const char *call, fmi2ValueReference vr) {
    char text[160];
    snprintf(text, sizeof text, "%s: there is no such variable: value reference %u", call, vr);
    return fmu_say(m, fmi2Error, text);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[]) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2GetReal", ANY)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        fmi2ValueReference k = vr[i];
        if (k < VR_OUTPUT) value[i] = m->state.wrench[k];
        else if (k < VR_ERROR) value[i] = fmu_answered(m)->outputs[k - VR_OUTPUT];
        else if (k < VR_COVERAGE) value[i] = fmu_answered(m)->error[k - VR_ERROR];
        else if (k >= VR_TOLERANCE && k < VR_WITHIN) value[i] = m->state.tolerance[k - VR_TOLERANCE];
        else return no_variable(m, "fmi2GetReal", k);
    }
    return fmi2OK;
}

/* Whether a variable may be set to a value now; reports if not. */
static int may_set(fmu_instance *m, fmi2ValueReference vr, double value) {
    char text[160];
    int load = vr < VR_OUTPUT, tolerance = vr >= VR_TOLERANCE && vr < VR_WITHIN;
    if (!load && !tolerance) {
        snprintf(text, sizeof text, "value reference %u cannot be set: it is no input", vr);
    } else if (load && !isfinite(value)) {
        snprintf(text, sizeof text, "input %u must be a finite number, N or N·m; nothing was set",
                 vr);
    } else if (tolerance && !(isfinite(value) && value >= 0)) {
        snprintf(text, sizeof text, "a tolerance must be a number above zero, m or rad, or zero for "
                 "the component's own; nothing was set");
    } else if (tolerance && !(m->state.mode & (INSTANTIATED | INITIALIZATION))) {
        snprintf(text, sizeof text, "a tolerance is fixed once the FMU is initialized");
    } else {
        return 1;
    }
    return fmu_say(m, fmi2Error, text), 0;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[]) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2SetReal", SETTING)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) /* all of them, or none */
        if (!may_set(m, vr[i], value[i])) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] < VR_OUTPUT) m->state.wrench[vr[i]] = value[i];
        else m->state.tolerance[vr[i] - VR_TOLERANCE] = value[i];
    }
    m->answered = m->derived = 0;
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Integer value[]) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2GetInteger", ANY)) return fmi2Error;
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] == VR_COVERAGE) value[i] = fmu_answered(m)->coverage;
        else if (vr[i] == VR_WITHIN) value[i] = fmu_answered(m)->within;
        else return no_variable(m, "fmi2GetInteger", vr[i]);
    }
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Integer value[]) {
    (void)vr, (void)value;
    if (!fmu_allowed(c, "fmi2SetInteger", SETTING)) return fmi2Error;
    return nvr ? fmu_say(c, fmi2Error, "integers are outputs: they cannot be set") : fmi2OK;
}

/* There are no variables of the other types. */
fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[]) {
    (void)value;
    return c && nvr ? no_variable(c, "fmi2GetBoolean", vr[0]) : fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          const fmi2Boolean value[]) {
    (void)value;
    return c && nvr ? no_variable(c, "fmi2SetBoolean", vr[0]) : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         fmi2String value[]) {
    (void)value;
    return c && nvr ? no_variable(c, "fmi2GetString", vr[0]) : fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                         const fmi2String value[]) {
    (void)value;
    return c && nvr ? no_variable(c, "fmi2SetString", vr[0]) : fmi2OK;
}

/* How the error bars change along a direction: by central differences, since bars have kinks. */
static void bar_slopes(fmu_instance *m, const double along[6], double slopes[6]) {
    const double *scale = m->table->scale;
    double size = 0.0, to[6], from[6];
    wb_reply high, low;
    for (int k = 0; k < 6; k++) size = fmax(size, fabs(along[k]) / scale[k]);
    for (int q = 0; q < 6; q++) slopes[q] = 0.0;
    if (!(size > 0)) return;
    double step = STEP_SHARE / size;
    for (int k = 0; k < 6; k++) {
        to[k] = m->state.wrench[k] + step * along[k];
        from[k] = m->state.wrench[k] - step * along[k];
    }
    fmu_ask(m, to, &high);
    fmu_ask(m, from, &low);
    for (int q = 0; q < 6; q++) slopes[q] = (high.error[q] - low.error[q]) / (2 * step);
}

/* The direction that the knowns span; 0 if one of them is no load. */
static int direction_of(fmu_instance *m, const fmi2ValueReference known[], size_t count,
                        const fmi2Real by[], double along[6]) {
    memset(along, 0, 6 * sizeof(double));
    for (size_t i = 0; i < count; i++) {
        if (known[i] >= VR_OUTPUT) {
            no_variable(m, "fmi2GetDirectionalDerivative (knowns are the six loads)", known[i]);
            return 0;
        }
        along[known[i]] += by[i];
    }
    return 1;
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknown[],
                                        size_t unknowns, const fmi2ValueReference known[],
                                        size_t knowns, const fmi2Real by[], fmi2Real out[]) {
    fmu_instance *m = c;
    double along[6], bars[6];
    int barred = 0, finite = 1;
    if (!fmu_allowed(m, "fmi2GetDirectionalDerivative", ANY)) return fmi2Error;
    if (!direction_of(m, known, knowns, by, along)) return fmi2Error;
    for (size_t i = 0; i < unknowns; i++) {
        fmi2ValueReference k = unknown[i];
        out[i] = 0.0;
        if (k >= VR_OUTPUT && k < VR_ERROR) {
            const double *row = fmu_derived(m) + 6 * (k - VR_OUTPUT);
            for (int load = 0; load < 6; load++) /* unknown by a load that does not change: 0 */
                if (along[load] != 0.0) out[i] += row[load] * along[load];
        } else if (k >= VR_ERROR && k < VR_COVERAGE) {
            if (!barred) bar_slopes(m, along, bars), barred = 1;
            out[i] = bars[k - VR_ERROR];
        } else {
            return no_variable(m, "fmi2GetDirectionalDerivative", k);
        }
        finite &= isfinite(out[i]) != 0;
    }
    if (finite) return fmi2OK;
    if (m->warned) return fmi2Warning; /* once: a loop would fill a log */
    m->warned = 1;
    return fmu_say(m, fmi2Warning, "the derivative is not known here: not a number");
}
