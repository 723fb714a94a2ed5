/* Model Exchange: the importer integrates. There are no events, so that event mode has nothing to do. */
#include "instance.h"

#include <math.h>
#include <string.h>

static const unsigned READABLE = MODES_READABLE & ~MODE_STEP;

Status instance_enter_event_mode(Instance *instance, const char *function)
{
    if (!allowed(instance, MODE_CONTINUOUS_TIME, function)) return STATUS_ERROR;
    instance->mode = MODE_EVENT;
    return STATUS_OK;
}

Status instance_enter_continuous_time_mode(Instance *instance, const char *function)
{
    if (!allowed(instance, MODE_EVENT, function)) return STATUS_ERROR;
    instance->mode = MODE_CONTINUOUS_TIME;
    return STATUS_OK;
}

Status instance_set_time(Instance *instance, double time, const char *function)
{
    if (!allowed(instance, MODE_EVENT | MODE_CONTINUOUS_TIME, function)) return STATUS_ERROR;
    if (!isfinite(time)) return refuse(instance, STATUS_ERROR, "%s: the time is not finite.", function);
    simulation_set_time(instance->simulation, time);
    return STATUS_OK;
}

/* Whether there is an array with room for exactly the states. */
static bool holds_states(const Instance *instance, const double array[], size_t n, const char *function)
{
    if (n != model.n_states) {
        refuse(instance, STATUS_ERROR, "%s: there are %zu continuous states, not %zu.", function, model.n_states, n);
        return false;
    }
    return present(instance, array, n, function);
}

Status instance_set_states(Instance *instance, const double x[], size_t n, const char *function)
{
    if (!allowed(instance, MODE_CONTINUOUS_TIME, function)) return STATUS_ERROR;
    if (!holds_states(instance, x, n, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; ++i) {
        if (!isfinite(x[i])) {
            return refuse(instance, STATUS_ERROR, "%s: the value for %s is not finite.", function,
                          model.variables[1 + i].name);
        }
    }
    simulation_set_states(instance->simulation, x);
    return STATUS_OK;
}

Status instance_get_states(const Instance *instance, double x[], size_t n, const char *function)
{
    if (!allowed(instance, READABLE, function) || !holds_states(instance, x, n, function)) return STATUS_ERROR;
    if (n > 0) memcpy(x, instance->simulation->x, n * sizeof(double));
    return STATUS_OK;
}

Status instance_get_derivatives(Instance *instance, double dx[], size_t n, const char *function)
{
    if (!allowed(instance, READABLE, function) || !holds_states(instance, dx, n, function)) return STATUS_ERROR;
    simulation_refresh(instance->simulation);
    if (n > 0) memcpy(dx, instance->simulation->dx, n * sizeof(double));
    for (size_t i = 0; i < n; ++i) {
        if (!isfinite(dx[i])) {
            /* Discard asks the importer for a smaller step (FMI 2.0, section 2.1.3; FMI 3.0, section 2.2.3). */
            return refuse(instance, STATUS_DISCARD, "%s: the derivative of %s is not finite at time %.10g.", function,
                          model.variables[1 + i].name, simulation_time(instance->simulation));
        }
    }
    return STATUS_OK;
}

Status instance_get_nominals(const Instance *instance, double nominals[], size_t n, const char *function)
{
    if (!allowed(instance, READABLE, function) || !holds_states(instance, nominals, n, function)) return STATUS_ERROR;
    for (size_t i = 0; i < n; ++i) nominals[i] = model.variables[1 + i].nominal;
    return STATUS_OK;
}

Status instance_get_event_indicators(const Instance *instance, const double indicators[], size_t n,
                                     const char *function)
{
    (void)indicators;
    if (!allowed(instance, READABLE, function)) return STATUS_ERROR;
    return n == 0 ? STATUS_OK : refuse(instance, STATUS_ERROR, "%s: there are no event indicators.", function);
}
