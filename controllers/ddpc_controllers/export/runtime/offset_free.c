#include "offset_free.h"

#include "vectors.h"

#include <string.h>

static void estimate_disturbance(const OffsetFree *wrapper, const OffsetFreeMemory *held, const double y[])
{
    const size_t p = wrapper->p;
    const double *directions = wrapper->directions + (size_t)*held->free * p * p;
    for (size_t i = 0; i < p; ++i) {
        if (*held->begun == 0.0) held->expected[i] = y[i] - held->disturbance[i];
        held->off[i] = y[i] - held->expected[i] - held->disturbance[i];
    }
    multiply(directions, held->off, p, p, held->correctable);
    for (size_t i = 0; i < p; ++i) {
        const bool grows = held->correctable[i] * held->disturbance[i] > 0.0;
        if (held->cut_off[i] != 0.0 && grows) held->correctable[i] = 0.0;
        held->disturbance[i] += wrapper->gain * held->correctable[i];
        held->expected[i] += held->off[i] - held->correctable[i];
    }
}

Sample shift_references(const OffsetFree *wrapper, const OffsetFreeMemory *held, const Sample *sample)
{
    const size_t p = wrapper->p, target = wrapper->horizon ? 1 : 0; /* the first that is to be reached */
    if (sample->applied != NULL) return *sample; /* no disturbance is known when it is switched on */
    if (all_finite(sample->y, p)) estimate_disturbance(wrapper, held, sample->y);
    else if (*held->begun == 0.0) memcpy(held->expected, sample->setpoint, p * sizeof(double));
    for (size_t k = 0; k <= wrapper->horizon; ++k) {
        const double *reference = k ? sample->reference + (k - 1) * p : sample->setpoint;
        for (size_t i = 0; i < p; ++i) {
            const double wanted = reference[i] - held->disturbance[i];
            const double shifted = clip(wanted, wrapper->y_min[i], wrapper->y_max[i]);
            held->shifted[k * p + i] = shifted;
            if (k != target) continue;
            held->cut_off[i] = shifted != wanted;
            held->expected[i] = wrapper->phi * held->expected[i] + (1.0 - wrapper->phi) * shifted;
        }
    }
    *held->begun = all_finite(held->expected, p); /* without a reference nothing is expected of the next sample */
    return (Sample){sample->y, sample->measured, held->shifted + p, held->shifted, NULL};
}

void remember_free(const OffsetFree *wrapper, const OffsetFreeMemory *held, const double u[])
{
    size_t set = 0;
    for (size_t i = 0; i < wrapper->m; ++i) {
        if (u[i] > wrapper->low[i] && u[i] < wrapper->high[i]) set += (size_t)1 << i;
    }
    *held->free = (double)set;
}
