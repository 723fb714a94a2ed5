#include "parts.h"

#include "vectors.h"

#include <math.h>
#include <string.h>

Sample sample_of_group(const Group *group, const Sample *sample, double memory[])
{
    double *y = memory, *measured = y + group->p, *setpoint = measured + group->q;
    double *reference = setpoint + group->p;
    choose(sample->y, group->of_outputs, group->p, y);
    choose(sample->measured, group->of_measurements, group->q, measured);
    choose(sample->setpoint, group->of_outputs, group->p, setpoint);
    for (size_t k = 0; k < group->horizon; ++k)
        choose(sample->reference + k * group->outputs, group->of_outputs, group->p, reference + k * group->p);
    double *applied = NULL;
    if (sample->applied != NULL) {
        applied = reference + group->horizon * group->p;
        choose(sample->applied, group->of_inputs, group->m, applied);
    }
    return (Sample){y, measured, reference, setpoint, applied};
}

void place_inputs(const Group *group, const double own[], double u[])
{
    for (size_t i = 0; i < group->m; ++i) u[group->of_inputs[i]] = own[i];
}

/* Let the outer controller's inputs begin where the inner outputs are. */
static void begin(const Cascade *cascade, const double y[], double memory[])
{
    for (size_t j = 0; j < cascade->targets; ++j) {
        if (!isfinite(y[j])) continue;
        const double moved = clip(y[j], cascade->low[j], cascade->high[j]) - cascade->rest[j];
        for (size_t i = 0; i < cascade->cells; ++i)
            memory[cascade->places[i]] += cascade->slopes[i * cascade->targets + j] * moved;
    }
}

bool take_sample(const Cascade *cascade, const CascadeMemory *held, const Sample *sample, double memory[])
{
    if (cascade->chosen != NULL) choose(sample->measured, cascade->chosen, cascade->targets, held->y);
    else memcpy(held->y, sample->y, cascade->targets * sizeof(double));
    if (sample->applied != NULL) return false; /* where the outer inputs begin is decided when it is switched on */
    if (*held->samples < 0.0) begin(cascade, held->y, memory);
    *held->samples += 1.0;
    if (*held->samples > 0.0 && *held->samples < (double)cascade->period) return false;
    *held->samples = 0.0;
    return true;
}

Sample outer_sample(const Cascade *cascade, const CascadeMemory *held, const Sample *sample)
{
    const size_t p = cascade->p;
    for (size_t k = 0; k < cascade->horizon; ++k)
        memcpy(held->later + k * p, sample->reference + ((k + 1) * cascade->period - 1) * p, p * sizeof(double));
    return (Sample){sample->y, sample->measured, held->later, sample->setpoint, NULL};
}

Sample inner_sample(const Cascade *cascade, const CascadeMemory *held, const Sample *sample)
{
    for (size_t k = 0; k < cascade->inner_horizon; ++k)
        memcpy(held->constant + k * cascade->targets, held->target, cascade->targets * sizeof(double));
    return (Sample){held->y, sample->measured, held->constant, held->target, sample->applied};
}
