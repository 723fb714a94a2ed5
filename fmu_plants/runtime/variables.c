/* Values of variables; all variables are floating point numbers of double precision. */
#include "instance.h"

#include <math.h>

/* The modes in which a variable may be set, none for what the model computes. */
static unsigned settable_in(VariableKind kind)
{
    switch (kind) {
    case VARIABLE_STATE:
    case VARIABLE_FIXED_PARAMETER: return MODES_BEFORE_SIMULATION;
    case VARIABLE_TUNABLE_PARAMETER: return MODES_BEFORE_SIMULATION | MODE_STEP | MODE_EVENT;
    case VARIABLE_INPUT: return MODES_BEFORE_SIMULATION | MODES_SIMULATING;
    case VARIABLE_TIME:
    case VARIABLE_DERIVATIVE:
    case VARIABLE_OUTPUT: return 0;
    }
    return 0;
}

static Status unknown_reference(const Instance *instance, const char *function, unsigned reference)
{
    return refuse(instance, STATUS_ERROR, "%s: there is no variable with value reference %u.", function, reference);
}

Status instance_get(Instance *instance, const unsigned references[], size_t n, double values[], const char *function)
{
    Status status = STATUS_OK;
    if (!allowed(instance, MODES_READABLE, function)) return STATUS_ERROR;
    if (!present(instance, references, n, function) || !present(instance, values, n, function)) return STATUS_ERROR;
    simulation_refresh(instance->simulation);
    for (size_t i = 0; i < n; ++i) {
        if (references[i] >= model.n_variables) return unknown_reference(instance, function, references[i]);
        values[i] = instance->simulation->values[references[i]];
        if (!isfinite(values[i])) {
            status = refuse(instance, STATUS_ERROR, "%s: %s is not finite at time %.10g.", function,
                            model.variables[references[i]].name, simulation_time(instance->simulation));
        }
    }
    return status;
}

static Status check_mode(const Instance *instance, const Variable *variable, const char *function)
{
    const unsigned modes = settable_in(variable->kind);
    if (modes & instance->mode) return STATUS_OK;
    if (!modes) {
        return refuse(instance, STATUS_ERROR, "%s: %s is computed by the model and cannot be set.", function,
                      variable->name);
    }
    if (variable->kind == VARIABLE_TUNABLE_PARAMETER) {
        return refuse(instance, STATUS_ERROR, "%s: %s cannot be set in continuous-time mode, only in event mode.",
                      function, variable->name);
    }
    return refuse(instance, STATUS_ERROR, "%s: %s can only be set before or in initialization mode.", function,
                  variable->name);
}

/* What is wrong with giving this variable this value now. */
static Status check_setting(const Instance *instance, unsigned reference, double value, const char *function)
{
    if (reference >= model.n_variables) return unknown_reference(instance, function, reference);
    const Variable *variable = &model.variables[reference];
    const Status status = check_mode(instance, variable, function);
    if (status != STATUS_OK) return status;
    if (!isfinite(value)) {
        return refuse(instance, STATUS_ERROR, "%s: the value for %s is not finite.", function, variable->name);
    }
    if (value >= variable->min && value <= variable->max) return STATUS_OK;
    if (variable->kind == VARIABLE_INPUT) {
        return refuse(instance, STATUS_WARNING, "%s: %s = %g is outside its range of %g to %g.", function,
                      variable->name, value, variable->min, variable->max);
    }
    return refuse(instance, STATUS_DISCARD, "%s: %s = %g is outside its range of %g to %g; nothing was set.", function,
                  variable->name, value, variable->min, variable->max);
}

Status instance_set(Instance *instance, const unsigned references[], size_t n, const double values[],
                    const char *function)
{
    Status status = STATUS_OK;
    if (!allowed(instance, MODES_BEFORE_SIMULATION | MODES_SIMULATING, function)) return STATUS_ERROR;
    if (!present(instance, references, n, function) || !present(instance, values, n, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; ++i) {
        const Status checked = check_setting(instance, references[i], values[i], function);
        if (checked > STATUS_WARNING) return checked;
        if (checked > status) status = checked;
    }
    for (size_t i = 0; i < n; ++i) simulation_set_value(instance->simulation, references[i], values[i]);
    return status;
}

static Status no_variables(const Instance *instance, size_t n, const char *function)
{
    if (n == 0) return STATUS_OK;
    return refuse(instance, STATUS_ERROR, "%s: there are no such variables.", function);
}

Status instance_get_other_type(const Instance *instance, size_t n, const char *function)
{
    return allowed(instance, MODES_READABLE, function) ? no_variables(instance, n, function) : STATUS_ERROR;
}

Status instance_set_other_type(const Instance *instance, size_t n, const char *function)
{
    const unsigned modes = MODES_BEFORE_SIMULATION | MODES_SIMULATING;
    return allowed(instance, modes, function) ? no_variables(instance, n, function) : STATUS_ERROR;
}
