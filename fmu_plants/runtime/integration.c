#include "integration.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Below this, rounding decides about the local error and the step size control chases noise. */
static const double SMALLEST_TOLERANCE = 1e-13;

enum { SAVED_STEP, SAVED_RELATIVE_TOLERANCE, SAVED_VALUES };

static void right_hand_side(double time, const double x[], void *context, double dx[])
{
    const Simulation *simulation = context;
    model.derivatives(time, x, simulation->u, simulation->p, dx);
}

Simulation *simulation_create(void)
{
    const size_t n = model.n_states;
    const size_t size = 3 * model.n_variables + model.n_partials + (DOPRI54_STAGES + 3) * n;
    Simulation *simulation = calloc(1, sizeof(Simulation) + size * sizeof(double));
    if (!simulation) return NULL;
    simulation->values = simulation->memory;
    simulation->x = simulation->values + 1; /* time comes first */
    simulation->dx = simulation->x + n;
    simulation->u = simulation->dx + n;
    simulation->y = simulation->u + model.n_inputs;
    simulation->p = simulation->y + model.n_outputs;
    simulation->seed = simulation->values + model.n_variables;
    simulation->sensitivity = simulation->seed + model.n_variables;
    simulation->jacobian = simulation->sensitivity + model.n_variables;
    simulation->absolute_tolerance = simulation->jacobian + model.n_partials;
    simulation->x_start = simulation->absolute_tolerance + n;
    simulation->method.n = n;
    simulation->method.absolute_tolerance = simulation->absolute_tolerance;
    simulation->method.stages = simulation->x_start + n;
    simulation->method.trial = simulation->method.stages + DOPRI54_STAGES * n;
    simulation_reset(simulation);
    return simulation;
}

void simulation_free(Simulation *simulation)
{
    free(simulation);
}

void simulation_reset(Simulation *simulation)
{
    for (size_t i = 0; i < model.n_variables; ++i) simulation->values[i] = model.variables[i].start;
    simulation->outdated = true;
    simulation->step = 0.0;
    simulation_set_tolerance(simulation, model.relative_tolerance);
}

/* The absolute tolerance keeps its ratio to the relative one. */
void simulation_set_tolerance(Simulation *simulation, double relative_tolerance)
{
    const double relative = fmax(relative_tolerance, SMALLEST_TOLERANCE);
    const double absolute = model.absolute_tolerance * (relative / model.relative_tolerance);
    const Variable *states = model.variables + 1;
    simulation->method.relative_tolerance = relative;
    for (size_t i = 0; i < model.n_states; ++i) simulation->absolute_tolerance[i] = absolute * states[i].nominal;
}

double simulation_time(const Simulation *simulation)
{
    return simulation->values[0];
}

void simulation_set_time(Simulation *simulation, double time)
{
    simulation->values[0] = time;
    simulation->outdated = true;
}

double simulation_value(const Simulation *simulation, size_t reference)
{
    return simulation->values[reference];
}

void simulation_set_value(Simulation *simulation, size_t reference, double value)
{
    simulation->values[reference] = value;
    simulation->outdated = true;
}

void simulation_set_states(Simulation *simulation, const double x[])
{
    if (model.n_states > 0) memcpy(simulation->x, x, model.n_states * sizeof(double));
    simulation->outdated = true;
}

void simulation_refresh(Simulation *simulation)
{
    if (!simulation->outdated) return;
    const double time = simulation_time(simulation);
    model.derivatives(time, simulation->x, simulation->u, simulation->p, simulation->dx);
    model.outputs(time, simulation->x, simulation->u, simulation->p, simulation->y);
    simulation->outdated = false;
}

void simulation_linearize(Simulation *simulation)
{
    model.jacobian(simulation_time(simulation), simulation->x, simulation->u, simulation->p, simulation->jacobian);
}

Advance simulation_advance(Simulation *simulation, double start, double span)
{
    const size_t size = model.n_states * sizeof(double);
    double elapsed;
    memcpy(simulation->x_start, simulation->x, size);
    const Dopri54Result result = dopri54_integrate(&simulation->method, right_hand_side, simulation, start, span,
                                                   simulation->x, &simulation->step, &elapsed);
    if (result == DOPRI54_DONE) {
        simulation_set_time(simulation, start + span);
    } else {
        memcpy(simulation->x, simulation->x_start, size);
    }
    return (Advance){result, start + elapsed};
}

size_t simulation_state_size(void)
{
    return SAVED_VALUES + model.n_variables;
}

void simulation_save(const Simulation *simulation, double state[])
{
    state[SAVED_STEP] = simulation->step;
    state[SAVED_RELATIVE_TOLERANCE] = simulation->method.relative_tolerance;
    memcpy(state + SAVED_VALUES, simulation->values, model.n_variables * sizeof(double));
}

void simulation_restore(Simulation *simulation, const double state[])
{
    simulation->step = state[SAVED_STEP];
    simulation_set_tolerance(simulation, state[SAVED_RELATIVE_TOLERANCE]);
    memcpy(simulation->values, state + SAVED_VALUES, model.n_variables * sizeof(double));
    simulation->outdated = true;
}
