/* What an instance computes: communication steps, what Model Exchange integrates, derivatives. */
#include "instance.h"
#include "integration.h"

#include <math.h>
#include <string.h>

/* Co-Simulation: communication steps. */

static const char *failure_reason(Dopri54Result result)
{
    switch (result) {
    case DOPRI54_DONE: break;
    case DOPRI54_NOT_FINITE: return "a derivative is not finite";
    case DOPRI54_STEP_VANISHED: return "the tolerance needs internal steps below the resolution of time";
    case DOPRI54_TOO_MANY_STEPS: return "too many internal steps (stiff equations, or far too long a step)";
    }
    return "";
}

Status instance_do_step(Instance *instance, double start, double size, const char *function)
{
    if (!allowed(instance, MODE_STEP, function)) return STATUS_ERROR;
    const Status checked = check_step(instance, start, size, function);
    if (checked != STATUS_OK) return checked;

    const Advance advance = simulation_advance(instance->simulation, start, size);
    if (advance.result == DOPRI54_DONE) return STATUS_OK;
    instance->mode = MODE_ERROR;
    return refuse(instance, STATUS_ERROR, "%s: the integration failed at time %.10g: %s.", function, advance.time,
                  failure_reason(advance.result));
}

/* Model Exchange: the importer integrates. There are no events, so that event mode has nothing to do. */

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

/* Directional and adjoint derivatives, from the Jacobian that was derived with the equations. */

/* Whether the variables can be differentiated, or (as knowns) be differentiated by. A state can be both: as an
 * output it is an unknown. */
static bool check_references(const Instance *instance, bool as_knowns, const unsigned references[], size_t n,
                             const char *function)
{
    if (!present(instance, references, n, function)) return false;
    for (size_t i = 0; i < n; ++i) {
        if (!known(instance, references[i], function)) return false;
        const Variable *variable = &model.variables[references[i]];
        const bool computed = variable->kind == VARIABLE_DERIVATIVE || variable->kind == VARIABLE_OUTPUT;
        if (computed == as_knowns && variable->kind != VARIABLE_STATE) {
            refuse(instance, STATUS_ERROR, "%s: %s is %s.", function, variable->name,
                   as_knowns ? "computed by the model and no known" : "not computed by the model and no unknown");
            return false;
        }
    }
    return true;
}

/* Collect the products by value reference; a state depends on itself. What is not asked about does not count,
 * even where its derivative is infinite. */
static void multiply(Simulation *simulation, bool transposed, const unsigned references[], size_t n,
                     const double seed[])
{
    double *from = simulation->seed, *to = simulation->sensitivity;
    memset(from, 0, model.n_variables * sizeof(double));
    memset(to, 0, model.n_variables * sizeof(double));
    for (size_t i = 0; i < n; ++i) from[references[i]] += seed[i];
    for (size_t i = 1; i <= model.n_states; ++i) to[i] = from[i];
    simulation_linearize(simulation);
    for (size_t i = 0; i < model.n_partials; ++i) {
        const Partial partial = model.partials[i];
        const unsigned row = transposed ? partial.known : partial.unknown;
        const unsigned column = transposed ? partial.unknown : partial.known;
        if (from[column] != 0.0) to[row] += simulation->jacobian[i] * from[column];
    }
}

Status instance_derivative(Instance *instance, bool adjoint, const unsigned from[], size_t n_from, const double seed[],
                           const unsigned to[], size_t n_to, double sensitivity[], const char *function)
{
    Status status = STATUS_OK;
    if (!allowed(instance, MODES_READABLE, function) ||
        !check_references(instance, !adjoint, from, n_from, function) ||
        !check_references(instance, adjoint, to, n_to, function) || !present(instance, seed, n_from, function) ||
        !present(instance, sensitivity, n_to, function)) {
        return STATUS_ERROR;
    }
    multiply(instance->simulation, adjoint, from, n_from, seed);
    for (size_t i = 0; i < n_to; ++i) {
        sensitivity[i] = instance->simulation->sensitivity[to[i]];
        if (!isfinite(sensitivity[i])) {
            status = refuse(instance, STATUS_ERROR, "%s: a derivative that %s takes part in is not finite.", function,
                            model.variables[to[i]].name);
        }
    }
    return status;
}
