/* FMI 2.0: variables and their derivatives. MIT license, as all of wrenchbook. */
#include "fmu.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

static const int ANY = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP | TERMINATED;
static const int SETTING = INSTANTIATED | INITIALIZATION | EVENT | CONTINUOUS | STEP;
static const double STEP_FRACTION = 1e-6; /* of the load range: between its rounding and its kinks */

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
        if (k < m->vr.output) value[i] = m->state.wrench[k];
        else if (k < m->vr.error) value[i] = fmu_answered(m)->outputs[k - m->vr.output];
        else if (k < m->vr.coverage) value[i] = fmu_answered(m)->error[k - m->vr.error];
        else if (k >= m->vr.tolerance && k < m->vr.within)
            value[i] = m->state.tolerance[k - m->vr.tolerance];
        else return no_variable(m, "fmi2GetReal", k);
    }
    return fmi2OK;
}

/* Whether a variable may be set to a value now; reports if not. */
static int may_set(fmu_instance *m, fmi2ValueReference vr, double value) {
    char text[160];
    int load = vr < m->vr.output, tolerance = vr >= m->vr.tolerance && vr < m->vr.within;
    if (!load && !tolerance) {
        snprintf(text, sizeof text, "value reference %u cannot be set: it is no input", vr);
    } else if (load && !isfinite(value)) {
        snprintf(text, sizeof text, "input %u must be a finite number; nothing was set", vr);
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
        if (vr[i] < m->vr.output) m->state.wrench[vr[i]] = value[i];
        else m->state.tolerance[vr[i] - m->vr.tolerance] = value[i];
    }
    m->answered = m->derived = 0;
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Integer value[]) {
    fmu_instance *m = c;
    if (!fmu_allowed(m, "fmi2GetInteger", ANY)) return fmi2Error;
    int held = m->state.mode == CONTINUOUS; /* discrete variables change at events alone */
    const wb_reply *now = fmu_answered(m);
    for (size_t i = 0; i < nvr; i++) {
        if (vr[i] == m->vr.coverage) value[i] = held ? m->state.event_coverage : now->coverage;
        else if (vr[i] == m->vr.within) value[i] = held ? m->state.event_within : now->within;
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
static void bar_slopes(fmu_instance *m, const double *along, double *slopes) {
    const double *scale = m->table->scale;
    double size = 0.0, to[WB_MAX], from[WB_MAX];
    wb_reply high, low;
    for (int k = 0; k < m->inputs; k++) size = fmax(size, fabs(along[k]) / scale[k]);
    for (int q = 0; q < m->outputs; q++) slopes[q] = 0.0;
    if (!(size > 0)) return;
    double step = STEP_FRACTION / size;
    for (int k = 0; k < m->inputs; k++) {
        to[k] = m->state.wrench[k] + step * along[k];
        from[k] = m->state.wrench[k] - step * along[k];
    }
    fmu_ask(m, to, &high);
    fmu_ask(m, from, &low);
    for (int q = 0; q < m->outputs; q++) slopes[q] = (high.error[q] - low.error[q]) / (2 * step);
}

/* The direction that the knowns span; 0 if one of them is no input. */
static int direction_of(fmu_instance *m, const fmi2ValueReference known[], size_t count,
                        const fmi2Real by[], double *along) {
    memset(along, 0, WB_MAX * sizeof(double));
    for (size_t i = 0; i < count; i++) {
        if (known[i] >= m->vr.output) {
            no_variable(m, "fmi2GetDirectionalDerivative (knowns are the inputs)", known[i]);
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
    double along[WB_MAX], bars[WB_MAX];
    int barred = 0, finite = 1;
    if (!fmu_allowed(m, "fmi2GetDirectionalDerivative", ANY)) return fmi2Error;
    if (!direction_of(m, known, knowns, by, along)) return fmi2Error;
    for (size_t i = 0; i < unknowns; i++) {
        fmi2ValueReference k = unknown[i];
        out[i] = 0.0;
        if (k >= m->vr.output && k < m->vr.error) {
            const double *row = fmu_derived(m) + m->inputs * (k - m->vr.output);
            for (int load = 0; load < m->inputs; load++) /* unknown by one that stays: 0 */
                if (along[load] != 0.0) out[i] += row[load] * along[load];
        } else if (k >= m->vr.error && k < m->vr.coverage) {
            if (!barred) bar_slopes(m, along, bars), barred = 1;
            out[i] = bars[k - m->vr.error];
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
