/* Simulation of a sampled block: it answers at the instants t0 + k * sampling_time, which are counted, and holds its
 * answer in between.
 *
 * At an instant, outputs that are read after inputs were set belong to these inputs, but the step that they come from
 * is taken on a copy of the state. The communication step that begins at the instant commits it. Until inputs are set
 * at the next instant, the outputs are the ones that were held.
 *
 * Of a plant the outputs follow from the state alone: they change when an instant is reached, whatever is set there. */
#include "sampled_block.h"

#include "instance.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

typedef enum {
    AT_INSTANT, /* outputs as they were held up to here */
    ASKED,      /* at an instant, inputs have been set */
    ANSWERED,   /* and outputs computed for them, with the state after that in the spare one */
    BETWEEN     /* instants */
} Phase;

struct Simulation {
    double start;          /* t0 */
    double instant;        /* number of the last instant that was reached */
    Phase phase;
    unsigned current;      /* which of the states is committed; the other one is spare */
    ControllerState states[2];
    double values[];       /* by value reference */
};

enum { N_NUMBERS = 3, SAVED_START = 0, SAVED_INSTANT, SAVED_PHASE, SAVED_NUMBERS };
enum { SAVED_MEMORY = SAVED_NUMBERS + N_NUMBERS, SAVED_VALUES = SAVED_MEMORY + CONTROLLER_MEMORY };

static size_t first_output(void)
{
    return 1 + block.n_measurements + block.n_references + (block.follow ? 1 + block.n_controls : 0);
}

static void show_state(Simulation *simulation)
{
    if (block.outputs) block.outputs(&simulation->states[simulation->current], simulation->values + first_output());
}

static double time_of(const Simulation *simulation, double instant)
{
    return simulation->start + instant * block.sampling_time;
}

Simulation *simulation_create(void)
{
    Simulation *simulation = calloc(1, sizeof(Simulation) + model.n_variables * sizeof(double));
    if (simulation) simulation_reset(simulation);
    return simulation;
}

void simulation_free(Simulation *simulation)
{
    free(simulation);
}

void simulation_reset(Simulation *simulation)
{
    for (size_t i = 0; i < model.n_variables; ++i) simulation->values[i] = model.variables[i].start;
    simulation->current = 0;
    controller_start(&simulation->states[0]);
    show_state(simulation);
    simulation_set_time(simulation, 0.0);
}

void simulation_set_tolerance(Simulation *simulation, double relative_tolerance)
{
    (void)simulation;
    (void)relative_tolerance;
}

double simulation_time(const Simulation *simulation)
{
    return simulation->values[0];
}

void simulation_set_time(Simulation *simulation, double time)
{
    simulation->values[0] = time;
    simulation->start = time;
    simulation->instant = 0.0;
    simulation->phase = ASKED;
}

double simulation_value(const Simulation *simulation, size_t reference)
{
    return simulation->values[reference];
}

void simulation_set_value(Simulation *simulation, size_t reference, double value)
{
    double *stored = &simulation->values[reference];
    const bool same = *stored == value || (isnan(*stored) && isnan(value));
    *stored = value;
    if (simulation->phase == AT_INSTANT || (simulation->phase == ANSWERED && !same)) simulation->phase = ASKED;
}

/* Compute outputs for the inputs as they are, and the state after that. */
static void answer(Simulation *simulation)
{
    ControllerState *next = &simulation->states[1 - simulation->current];
    const double *y = simulation->values + 1, *r = y + block.n_measurements;
    const double *active = r + block.n_references;
    double *u = simulation->values + first_output(), *numbers = u + block.n_controls;
    *next = simulation->states[simulation->current];
    if (block.outputs) {
        controller_step(next, y, r, u);
        simulation->phase = ANSWERED;
        return;
    }
    if (block.follow && *active == 0.0) {
        memcpy(u, active + 1, block.n_controls * sizeof(double));
        block.follow(next, y, r, u);
    } else {
        controller_step(next, y, r, u);
    }
    numbers[0] = next->status;
    numbers[1] = next->iterations;
    numbers[2] = next->active_bounds;
    simulation->phase = ANSWERED;
}

void simulation_refresh(Simulation *simulation)
{
    if (simulation->phase == ASKED) answer(simulation);
}

size_t simulation_state_size(void)
{
    return SAVED_VALUES + model.n_variables;
}

void simulation_save(const Simulation *simulation, double state[])
{
    const ControllerState *current = &simulation->states[simulation->current];
    const double numbers[N_NUMBERS] = {current->status, current->iterations, current->active_bounds};
    state[SAVED_START] = simulation->start;
    state[SAVED_INSTANT] = simulation->instant;
    /* What was computed is not saved, it is computed again. */
    state[SAVED_PHASE] = simulation->phase == ANSWERED ? ASKED : simulation->phase;
    memcpy(state + SAVED_NUMBERS, numbers, sizeof numbers);
    memcpy(state + SAVED_MEMORY, current->memory, sizeof current->memory);
    memcpy(state + SAVED_VALUES, simulation->values, model.n_variables * sizeof(double));
}

void simulation_restore(Simulation *simulation, const double state[])
{
    ControllerState *current = &simulation->states[simulation->current];
    simulation->start = state[SAVED_START];
    simulation->instant = state[SAVED_INSTANT];
    simulation->phase = (Phase)state[SAVED_PHASE];
    current->status = (unsigned)state[SAVED_NUMBERS];
    current->iterations = (unsigned)state[SAVED_NUMBERS + 1];
    current->active_bounds = (unsigned)state[SAVED_NUMBERS + 2];
    memcpy(current->memory, state + SAVED_MEMORY, sizeof current->memory);
    memcpy(simulation->values, state + SAVED_VALUES, model.n_variables * sizeof(double));
}

/* Co-Simulation: communication steps that meet every instant. Of importers that add up times or end at a stop time of
 * their own the last one can be of any length up to the next instant. */

/* The first output that is not finite; NULL if there is none. */
static const Variable *fault_of_answer(const Simulation *simulation)
{
    for (size_t i = first_output(); i < model.n_variables; ++i) {
        if (!isfinite(simulation->values[i])) return &model.variables[i];
    }
    return NULL;
}

Status instance_do_step(Instance *instance, double start, double size, const char *function)
{
    if (!allowed(instance, MODE_STEP, function)) return STATUS_ERROR;
    const Status checked = check_step(instance, start, size, function);
    if (checked != STATUS_OK) return checked;

    Simulation *simulation = instance->simulation;
    const double time = simulation_time(simulation), end = time + size;
    const double next = time_of(simulation, simulation->instant + 1.0);
    const double tolerance = fmin(time_tolerance(next, size), 0.25 * size);
    if (!(end <= next + tolerance)) {
        return refuse(instance, STATUS_ERROR,
                      "%s: the step from %.10g to %.10g goes past a sampling instant, %.10g: steps must be as long as the "
                      "sampling time, %.10g, or an integer fraction of it.",
                      function, time, end, next, block.sampling_time);
    }
    if (simulation->phase != BETWEEN) {
        if (simulation->phase != ANSWERED) answer(simulation);
        const Variable *fault = fault_of_answer(simulation);
        if (fault) {
            instance->mode = MODE_ERROR;
            return refuse(instance, STATUS_ERROR, "%s: %s is not finite at time %.10g.", function, fault->name, time);
        }
        simulation->current = 1 - simulation->current;
        simulation->phase = BETWEEN;
    }
    simulation->values[0] = end;
    if (end >= next - tolerance) {
        simulation->values[0] = next;
        simulation->instant += 1.0;
        simulation->phase = AT_INSTANT;
        show_state(simulation);
    }
    return STATUS_OK;
}

/* Derivatives and Model Exchange, which a sampled block does not have: no instance reaches their modes. */

static Status not_there(const Instance *instance, const char *function)
{
    if (!allowed(instance, MODES_ANY, function)) return STATUS_ERROR;
    return refuse(instance, STATUS_ERROR, "%s: this FMU does not have it.", function);
}

Status instance_derivative(Instance *instance, bool adjoint, const unsigned from[], size_t n_from, const double seed[],
                           const unsigned to[], size_t n_to, double sensitivity[], const char *function)
{
    (void)adjoint;
    (void)from;
    (void)n_from;
    (void)seed;
    (void)to;
    (void)n_to;
    (void)sensitivity;
    return not_there(instance, function);
}

Status instance_enter_event_mode(Instance *instance, const char *function)
{
    return not_there(instance, function);
}

Status instance_enter_continuous_time_mode(Instance *instance, const char *function)
{
    return not_there(instance, function);
}

Status instance_set_time(Instance *instance, double time, const char *function)
{
    (void)time;
    return not_there(instance, function);
}

Status instance_set_states(Instance *instance, const double x[], size_t n, const char *function)
{
    (void)x;
    (void)n;
    return not_there(instance, function);
}

Status instance_get_states(const Instance *instance, double x[], size_t n, const char *function)
{
    (void)x;
    (void)n;
    return not_there(instance, function);
}

Status instance_get_derivatives(Instance *instance, double dx[], size_t n, const char *function)
{
    (void)dx;
    (void)n;
    return not_there(instance, function);
}

Status instance_get_nominals(const Instance *instance, double nominals[], size_t n, const char *function)
{
    (void)nominals;
    (void)n;
    return not_there(instance, function);
}

Status instance_get_event_indicators(const Instance *instance, const double indicators[], size_t n,
                                     const char *function)
{
    (void)indicators;
    (void)n;
    return not_there(instance, function);
}
