#include "scaled.h"

#include <math.h>

Sample scale_sample(const Scaled *scaled, const Sample *sample, double memory[])
{
    double *y = memory, *measured = y + scaled->p, *setpoint = measured + scaled->q;
    double *reference = setpoint + scaled->p;
    for (size_t i = 0; i < scaled->p; ++i) y[i] = sample->y[i] / scaled->y[i];
    for (size_t i = 0; i < scaled->q; ++i) measured[i] = sample->measured[i] / scaled->measured[i];
    for (size_t i = 0; i < scaled->p; ++i) setpoint[i] = sample->setpoint[i] / scaled->y[i];
    for (size_t k = 0; k < scaled->horizon; ++k)
        for (size_t i = 0; i < scaled->p; ++i)
            reference[k * scaled->p + i] = sample->reference[k * scaled->p + i] / scaled->y[i];
    double *applied = NULL;
    if (sample->applied != NULL) {
        applied = reference + scaled->horizon * scaled->p;
        for (size_t i = 0; i < scaled->m; ++i) applied[i] = sample->applied[i] / scaled->u[i];
    }
    return (Sample){y, measured, reference, setpoint, applied};
}

void unscale_inputs(const Scaled *scaled, double u[])
{
    for (size_t i = 0; i < scaled->m; ++i) {
        u[i] *= scaled->u[i];
        if (u[i] <= scaled->near_low[i]) u[i] = scaled->low[i];
        else if (u[i] >= scaled->near_high[i]) u[i] = scaled->high[i];
    }
}
