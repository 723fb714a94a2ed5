/* What one instance computes, as every front end uses it: no FMI types, no messages.
 *
 * `integration.c` has it for plants, whose equations are integrated, `sampled_block.c` for blocks that answer at
 * sampling instants. Variables are known by value reference, their position in `model.variables`. */
#ifndef SIMULATION_H
#define SIMULATION_H

#include "model.h"

#include <stddef.h>

typedef struct Simulation Simulation;

Simulation *simulation_create(void); /* NULL if there is no memory */
void simulation_free(Simulation *simulation);

/* Start values, default tolerances, time 0. */
void simulation_reset(Simulation *simulation);

/* The relative tolerance of an integration. */
void simulation_set_tolerance(Simulation *simulation, double relative_tolerance);

double simulation_time(const Simulation *simulation);
void simulation_set_time(Simulation *simulation, double time);
double simulation_value(const Simulation *simulation, size_t reference);
void simulation_set_value(Simulation *simulation, size_t reference, double value);

/* Bring what is computed up to date with what was set. */
void simulation_refresh(Simulation *simulation);

/* The complete state as `simulation_state_size()` numbers. */
size_t simulation_state_size(void);
void simulation_save(const Simulation *simulation, double state[]);
void simulation_restore(Simulation *simulation, const double state[]);

#endif
