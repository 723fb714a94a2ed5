/* A sampled block as the runtime sees it: a controller in C, or a plant, and how many signals it has.
 *
 * The variables of its FMU follow one another: time, measurements, references, of one that can follow the plant whether it
 * is active and the inputs that are applied where it is not, inputs of the plant, and three numbers about the answer:
 * status, iterations, active bounds. Those of a plant are time, what drives it, as measurements, and what it gives. */
#ifndef SAMPLED_BLOCK_H
#define SAMPLED_BLOCK_H

#include "controller.h"

#include <stddef.h>

typedef struct {
    double sampling_time;
    size_t n_measurements;
    size_t n_references;
    size_t n_controls;
    unsigned (*follow)(ControllerState *state, const double y[], const double r[], double u[]); /* NULL: it cannot */
    void (*outputs)(const ControllerState *state, double u[]); /* of a plant, whose step leaves u; NULL: none */
} SampledBlock;

extern const SampledBlock block;

#endif
