/* FMI 2.0: values of variables (section 2.1.7). All variables are of type Real. */
#include "fmi2_instance.h"

#include <math.h>

static const unsigned READABLE = MODE_INITIALIZATION | MODE_STEP_COMPLETE | MODE_TERMINATED | MODE_ERROR;
static const unsigned BEFORE_SIMULATION = MODE_INSTANTIATED | MODE_INITIALIZATION;

/* The modes in which a variable may be set, none for what the model computes. */
static unsigned settable_in(VariableKind kind)
{
    switch (kind) {
    case VARIABLE_STATE:
    case VARIABLE_FIXED_PARAMETER: return BEFORE_SIMULATION;
    case VARIABLE_INPUT:
    case VARIABLE_TUNABLE_PARAMETER: return BEFORE_SIMULATION | MODE_STEP_COMPLETE;
    case VARIABLE_TIME:
    case VARIABLE_DERIVATIVE:
    case VARIABLE_OUTPUT: return 0;
    }
    return 0;
}

static fmi2Status unknown_reference(const Instance *instance, const char *function, fmi2ValueReference reference)
{
    return refuse(instance, fmi2Error, "%s: there is no variable with value reference %u.", function, reference);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    if (!allowed(instance, READABLE, "fmi2GetReal")) return fmi2Error;
    if (!present(instance, vr, nvr, "fmi2GetReal") || !present(instance, value, nvr, "fmi2GetReal")) return fmi2Error;
    simulation_refresh(instance->simulation);
    for (size_t i = 0; i < nvr; ++i) {
        if (vr[i] >= model.n_variables) return unknown_reference(instance, "fmi2GetReal", vr[i]);
        value[i] = instance->simulation->values[vr[i]];
        if (!isfinite(value[i])) {
            status = refuse(instance, fmi2Error, "fmi2GetReal: %s is not finite at time %.10g.",
                            model.variables[vr[i]].name, simulation_time(instance->simulation));
        }
    }
    return status;
}

/* What is wrong with giving this variable this value now. */
static fmi2Status check_setting(const Instance *instance, fmi2ValueReference reference, double value)
{
    if (reference >= model.n_variables) return unknown_reference(instance, "fmi2SetReal", reference);
    const Variable *variable = &model.variables[reference];
    const unsigned modes = settable_in(variable->kind);
    if (!modes) {
        return refuse(instance, fmi2Error, "fmi2SetReal: %s is computed by the model and cannot be set.",
                      variable->name);
    }
    if (!(modes & instance->mode)) {
        return refuse(instance, fmi2Error, "fmi2SetReal: %s can only be set before or in initialization mode.",
                      variable->name);
    }
    if (!isfinite(value)) {
        return refuse(instance, fmi2Error, "fmi2SetReal: the value for %s is not finite.", variable->name);
    }
    if (value >= variable->min && value <= variable->max) return fmi2OK;
    if (variable->kind == VARIABLE_INPUT) {
        return refuse(instance, fmi2Warning, "fmi2SetReal: %s = %g is outside its range of %g to %g.", variable->name,
                      value, variable->min, variable->max);
    }
    return refuse(instance, fmi2Discard, "fmi2SetReal: %s = %g is outside its range of %g to %g; nothing was set.",
                  variable->name, value, variable->min, variable->max);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    Instance *instance = c;
    fmi2Status status = fmi2OK;
    if (!allowed(instance, BEFORE_SIMULATION | MODE_STEP_COMPLETE, "fmi2SetReal")) return fmi2Error;
    if (!present(instance, vr, nvr, "fmi2SetReal") || !present(instance, value, nvr, "fmi2SetReal")) return fmi2Error;
    for (size_t i = 0; i < nvr; ++i) {
        const fmi2Status checked = check_setting(instance, vr[i], value[i]);
        if (checked > fmi2Warning) return checked;
        if (checked > status) status = checked;
    }
    for (size_t i = 0; i < nvr; ++i) simulation_set_value(instance->simulation, vr[i], value[i]);
    return status;
}

/* Access to no variable succeeds, access to any fails: there is none of another type. */
static fmi2Status no_variables(const Instance *instance, size_t n, const char *function, unsigned modes)
{
    if (!allowed(instance, modes, function)) return fmi2Error;
    return n == 0 ? fmi2OK : refuse(instance, fmi2Error, "%s: all variables of this FMU are of type Real.", function);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, nvr, "fmi2GetInteger", READABLE);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, nvr, "fmi2GetBoolean", READABLE);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, nvr, "fmi2GetString", READABLE);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, nvr, "fmi2SetInteger", BEFORE_SIMULATION | MODE_STEP_COMPLETE);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, nvr, "fmi2SetBoolean", BEFORE_SIMULATION | MODE_STEP_COMPLETE);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr;
    (void)value;
    return no_variables(c, nvr, "fmi2SetString", BEFORE_SIMULATION | MODE_STEP_COMPLETE);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    (void)vUnknown_ref;
    (void)nUnknown;
    (void)vKnown_ref;
    (void)nKnown;
    (void)dvKnown;
    (void)dvUnknown;
    if (!allowed(c, READABLE, "fmi2GetDirectionalDerivative")) return fmi2Error;
    return refuse(c, fmi2Error, "fmi2GetDirectionalDerivative: this FMU provides no directional derivatives.");
}
