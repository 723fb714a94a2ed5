/* Simulation by integrating the equations of a plant.
 *
 * `values` holds every variable by value reference; x, dx, u, y and p point to its blocks (see model.h). */
#ifndef INTEGRATION_H
#define INTEGRATION_H

#include "dopri54.h"
#include "simulation.h"

#include <stdbool.h>

struct Simulation {
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
};

typedef struct {
    Dopri54Result result;
    double time; /* where the integration ended */
} Advance;

void simulation_set_states(Simulation *simulation, const double x[]);

/* Evaluate the Jacobian at the present time, states, inputs and parameters. */
void simulation_linearize(Simulation *simulation);

/* Integrate from `start` by `span` with inputs held; after a failure the states are those at `start`. */
Advance simulation_advance(Simulation *simulation, double start, double span);

#endif
