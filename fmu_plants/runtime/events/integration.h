/* Simulation by integrating the equations of a plant that reads tables or has a control of its own.
 *
 * The FMU of such a plant has it in the place of the other integration.h. Between two events, which are the rows of
 * tables and the instants of the control, columns are straight lines in time and what the control commands is held.
 * `values` and its blocks are as in the other one; a last block follows the parameters: s, the memory of the control
 * and what acts on the plant as its actuators. */
#ifndef INTEGRATION_H
#define INTEGRATION_H

#include "dopri54.h"
#include "simulation.h"
#include "tables.h"

#include <stdbool.h>

/* c: the columns of all tables. */
typedef void (*EventFunction)(double time, const double x[], const double u[], const double p[], const double s[],
                              const double c[], double result[]);

/* What a plant has besides `model`, whose functions are NULL. The last inputs are, for each actuator, its override
 * and the switch of that. */
typedef struct {
    size_t n_parameters;
    size_t n_memory;
    size_t n_actuators;
    size_t n_columns;
    size_t n_tables;
    const TableSource *tables;
    double sampling_time;  /* of the control */
    EventFunction derivatives;
    EventFunction outputs;
    EventFunction jacobian;
    EventFunction control; /* the next memory and the commands; NULL: there is no control */
} Events;

extern const Events events;

struct Simulation {
    double *values;
    double *x;
    double *dx;
    double *u;
    double *y;
    double *p;
    double *s;
    double *c;
    bool outdated;   /* dx, y, s and c do not belong to the present x, u, p */
    double start;    /* time of the control's first instant */
    double instant;  /* number of the control's next instant, 0, 1, ... */
    bool due;        /* that instant is now: what the control decides may still change with the inputs */
    double *kept;    /* memory and commands since the last instant */
    double *decided; /* memory and commands from the instant that is due on */
    double step;     /* internal step size to go on with, 0 if unknown */
    Dopri54 method;
    double *absolute_tolerance;
    double *before;  /* the complete state at the beginning of a communication step, to go back to */
    double *jacobian;
    double *seed;
    double *sensitivity;
    Table *tables;
    double memory[]; /* what all of these but the tables point into */
};

typedef struct {
    Dopri54Result result;
    double time; /* where the integration ended */
} Advance;

/* Make the tables part of a simulation, which frees them. */
void simulation_use_tables(Simulation *simulation, Table *tables);

void simulation_set_states(Simulation *simulation, const double x[]);

/* Evaluate the Jacobian at the present time, with columns and commands held. */
void simulation_linearize(Simulation *simulation);

/* Integrate from `start` by `span` with inputs held, from event to event; after a failure everything is as before. */
Advance simulation_advance(Simulation *simulation, double start, double span);

#endif
