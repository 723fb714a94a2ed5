/* One instance of the model with its integrator, as every front end uses it: no FMI types, no messages.
 *
 * `values` holds every variable by value reference; x, dx, u, y and p point to its blocks (see model.h). */
#ifndef SIMULATION_H
#define SIMULATION_H

#include "dopri54.h"
#include "model.h"

#include <stdbool.h>
#include <stddef.h>

typedef struct {
    double *values;
    double *x;
    double *dx;
    double *u;
    double *y;
    double *p;
    bool outdated;  /* dx and y do not belong to the present x, u, p */
    double step;    /* internal step size to begin the next communication step with, 0 if unknown */
    Dopri54 method;
    double *absolute_tolerance;
    double *x_start;     /* states at the beginning of a communication step, to go back to */
    double *jacobian;    /* its elements in the order of model.partials, after simulation_linearize */
    double *seed;        /* by value reference, like `sensitivity`: room for products with the Jacobian */
    double *sensitivity;
    double memory[];     /* what all of these point into */
} Simulation;

typedef struct {
    Dopri54Result result;
    double time; /* where the integration ended */
} Advance;

Simulation *simulation_create(void); /* NULL if there is no memory */
void simulation_free(Simulation *simulation);

/* Start values, default tolerances, time 0. */
void simulation_reset(Simulation *simulation);

/* The relative tolerance; the absolute one keeps its ratio to it. Tolerances below 1e-13 count as 1e-13. */
void simulation_set_tolerance(Simulation *simulation, double relative_tolerance);

double simulation_time(const Simulation *simulation);
void simulation_set_time(Simulation *simulation, double time);
void simulation_set_value(Simulation *simulation, size_t reference, double value);
void simulation_set_states(Simulation *simulation, const double x[]);

/* Bring derivatives and algebraic outputs up to date with states, inputs and parameters. */
void simulation_refresh(Simulation *simulation);

/* Evaluate the Jacobian at the present time, states, inputs and parameters. */
void simulation_linearize(Simulation *simulation);

/* Integrate from `start` by `span` with inputs held; after a failure the states are those at `start`. */
Advance simulation_advance(Simulation *simulation, double start, double span);

/* The complete state as `simulation_state_size()` numbers. */
size_t simulation_state_size(void);
void simulation_save(const Simulation *simulation, double state[]);
void simulation_restore(Simulation *simulation, const double state[]);

#endif
