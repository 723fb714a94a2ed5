#include "integration.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Below this, rounding decides about the local error and the step size control chases noise. */
static const double SMALLEST_TOLERANCE = 1e-13;

enum { SAVED_STEP, SAVED_RELATIVE_TOLERANCE, SAVED_START, SAVED_INSTANT, SAVED_DUE, SAVED_KEPT };

static size_t n_kept(void)
{
    return events.n_memory + events.n_actuators;
}

/* How far an event may lie from the time that an importer computed for it in another way. */
static double resolution(double time)
{
    return 1e-10 * fabs(time) + 1e-12;
}

static void read_columns(Simulation *simulation, double time)
{
    double *column = simulation->c;
    for (size_t i = 0; i < events.n_tables && simulation->tables; ++i) {
        table_values(&simulation->tables[i], time, column);
        column += simulation->tables[i].source->n_columns;
    }
}

static void right_hand_side(double time, const double x[], void *context, double dx[])
{
    Simulation *simulation = context;
    read_columns(simulation, time);
    events.derivatives(time, x, simulation->u, simulation->p, simulation->s, simulation->c, dx);
}

Simulation *simulation_create(void)
{
    const size_t n = model.n_states;
    const size_t size = 3 * model.n_variables + events.n_columns + 2 * n_kept() + simulation_state_size() +
                        model.n_partials + (DOPRI54_STAGES + 2) * n;
    Simulation *simulation = calloc(1, sizeof(Simulation) + size * sizeof(double));
    if (!simulation) return NULL;
    simulation->values = simulation->memory;
    simulation->x = simulation->values + 1; /* time comes first */
    simulation->dx = simulation->x + n;
    simulation->u = simulation->dx + n;
    simulation->y = simulation->u + model.n_inputs;
    simulation->p = simulation->y + model.n_outputs;
    simulation->s = simulation->p + events.n_parameters;
    simulation->seed = simulation->values + model.n_variables;
    simulation->sensitivity = simulation->seed + model.n_variables;
    simulation->c = simulation->sensitivity + model.n_variables;
    simulation->kept = simulation->c + events.n_columns;
    simulation->decided = simulation->kept + n_kept();
    simulation->before = simulation->decided + n_kept();
    simulation->jacobian = simulation->before + simulation_state_size();
    simulation->absolute_tolerance = simulation->jacobian + model.n_partials;
    simulation->method.n = n;
    simulation->method.absolute_tolerance = simulation->absolute_tolerance;
    simulation->method.stages = simulation->absolute_tolerance + n;
    simulation->method.trial = simulation->method.stages + DOPRI54_STAGES * n;
    simulation_reset(simulation);
    return simulation;
}

void simulation_free(Simulation *simulation)
{
    if (!simulation) return;
    tables_free(simulation->tables, events.n_tables);
    free(simulation);
}

/* Be at a time: in the piece of every table that it lies in, and with the control's instant due if it is that. */
static void arrive(Simulation *simulation, double time)
{
    const double reached = time + resolution(time);
    simulation->values[0] = time;
    simulation->outdated = true;
    simulation->due = events.control && simulation->start + simulation->instant * events.sampling_time <= reached;
    for (size_t i = 0; i < events.n_tables && simulation->tables; ++i) table_go_to(&simulation->tables[i], reached);
}

void simulation_use_tables(Simulation *simulation, Table *tables)
{
    simulation->tables = tables;
    arrive(simulation, simulation_time(simulation));
}

void simulation_reset(Simulation *simulation)
{
    for (size_t i = 0; i < model.n_variables; ++i) simulation->values[i] = model.variables[i].start;
    if (n_kept() > 0) memcpy(simulation->kept, simulation->s, n_kept() * sizeof(double));
    simulation->step = 0.0;
    simulation_set_tolerance(simulation, model.relative_tolerance);
    simulation_set_time(simulation, simulation_time(simulation));
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

/* Begin at a time, the first instant of the control. */
void simulation_set_time(Simulation *simulation, double time)
{
    simulation->start = time;
    simulation->instant = 0.0;
    arrive(simulation, time);
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

/* Have the memory, and act with the commands or what overrides them. */
static void act(Simulation *simulation, const double kept[])
{
    const double *override = simulation->u + model.n_inputs - 2 * events.n_actuators;
    for (size_t i = 0; i < n_kept(); ++i) simulation->s[i] = kept[i];
    for (size_t i = 0; i < events.n_actuators; ++i, override += 2) {
        if (override[1] > 0.5) simulation->s[events.n_memory + i] = override[0];
    }
}

/* Bring up to date what acts on the plant. At an instant, the control sees what acted until then. */
static void act_now(Simulation *simulation)
{
    const double time = simulation_time(simulation);
    read_columns(simulation, time);
    act(simulation, simulation->kept);
    if (!simulation->due) return;
    events.control(time, simulation->x, simulation->u, simulation->p, simulation->s, simulation->c,
                   simulation->decided);
    act(simulation, simulation->decided);
}

void simulation_refresh(Simulation *simulation)
{
    if (!simulation->outdated) return;
    act_now(simulation);
    const double time = simulation_time(simulation);
    events.derivatives(time, simulation->x, simulation->u, simulation->p, simulation->s, simulation->c,
                       simulation->dx);
    events.outputs(time, simulation->x, simulation->u, simulation->p, simulation->s, simulation->c, simulation->y);
    simulation->outdated = false;
}

void simulation_linearize(Simulation *simulation)
{
    act_now(simulation);
    events.jacobian(simulation_time(simulation), simulation->x, simulation->u, simulation->p, simulation->s,
                    simulation->c, simulation->jacobian);
}

static double next_event(const Simulation *simulation)
{
    double next = events.control ? simulation->start + simulation->instant * events.sampling_time : INFINITY;
    for (size_t i = 0; i < events.n_tables; ++i) next = fmin(next, simulation->tables[i].until);
    return next;
}

/* Let the control decide if its instant is due: from now on this is what it has decided. */
static void decide(Simulation *simulation)
{
    act_now(simulation);
    if (!simulation->due) return;
    if (n_kept() > 0) memcpy(simulation->kept, simulation->decided, n_kept() * sizeof(double));
    simulation->instant += 1.0;
    simulation->due = false;
}

Advance simulation_advance(Simulation *simulation, double start, double span)
{
    const double end = start + span;
    Advance advance = {DOPRI54_DONE, simulation_time(simulation)};
    simulation_save(simulation, simulation->before);
    while (advance.result == DOPRI54_DONE && advance.time < end) {
        double elapsed;
        decide(simulation);
        const double next = next_event(simulation);
        const double stop = next < end - resolution(end) ? next : end;
        advance.result = dopri54_integrate(&simulation->method, right_hand_side, simulation, advance.time,
                                           stop - advance.time, simulation->x, &simulation->step, &elapsed);
        if (advance.result == DOPRI54_DONE) {
            advance.time = stop;
            arrive(simulation, stop);
        } else {
            advance.time += elapsed;
        }
    }
    if (advance.result != DOPRI54_DONE) simulation_restore(simulation, simulation->before);
    return advance;
}

size_t simulation_state_size(void)
{
    return SAVED_KEPT + n_kept() + model.n_variables;
}

void simulation_save(const Simulation *simulation, double state[])
{
    state[SAVED_STEP] = simulation->step;
    state[SAVED_RELATIVE_TOLERANCE] = simulation->method.relative_tolerance;
    state[SAVED_START] = simulation->start;
    state[SAVED_INSTANT] = simulation->instant;
    state[SAVED_DUE] = simulation->due;
    if (n_kept() > 0) memcpy(state + SAVED_KEPT, simulation->kept, n_kept() * sizeof(double));
    memcpy(state + SAVED_KEPT + n_kept(), simulation->values, model.n_variables * sizeof(double));
}

void simulation_restore(Simulation *simulation, const double state[])
{
    simulation->step = state[SAVED_STEP];
    simulation_set_tolerance(simulation, state[SAVED_RELATIVE_TOLERANCE]);
    simulation->start = state[SAVED_START];
    simulation->instant = state[SAVED_INSTANT];
    if (n_kept() > 0) memcpy(simulation->kept, state + SAVED_KEPT, n_kept() * sizeof(double));
    memcpy(simulation->values, state + SAVED_KEPT + n_kept(), model.n_variables * sizeof(double));
    arrive(simulation, simulation->values[0]);
    simulation->due = state[SAVED_DUE] != 0.0;
}
