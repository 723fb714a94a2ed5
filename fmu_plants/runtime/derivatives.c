/* Directional and adjoint derivatives, from the Jacobian that was derived with the equations. */
#include "instance.h"

#include <math.h>
#include <string.h>

/* Whether the variables can be differentiated, or (as knowns) be differentiated by. A state can be both: as an
 * output it is an unknown. */
static bool check(const Instance *instance, bool as_knowns, const unsigned references[], size_t n,
                  const char *function)
{
    if (!present(instance, references, n, function)) return false;
    for (size_t i = 0; i < n; ++i) {
        if (references[i] >= model.n_variables) {
            refuse(instance, STATUS_ERROR, "%s: there is no variable with value reference %u.", function,
                   references[i]);
            return false;
        }
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
    if (!allowed(instance, MODES_READABLE, function) || !check(instance, !adjoint, from, n_from, function) ||
        !check(instance, adjoint, to, n_to, function) || !present(instance, seed, n_from, function) ||
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
