#include "offset_free.h"

#include "vectors.h"

#include <string.h>

/* The parts of the memory. */
typedef struct {
    double *begun, *free, *disturbance, *expected, *cut_off, *off, *correctable, *shifted;
} Parts;

static Parts parts_of(const OffsetFree *wrapper, double memory[])
{
    Parts parts = {.begun = memory, .free = memory + 1};
    parts.disturbance = parts.free + 1;
    parts.expected = parts.disturbance + wrapper->p;
    parts.cut_off = parts.expected + wrapper->p;
    parts.off = parts.cut_off + wrapper->p;
    parts.correctable = parts.off + wrapper->p;
    parts.shifted = parts.correctable + wrapper->p;
    return parts;
}

static void estimate_disturbance(const OffsetFree *wrapper, const Parts *parts, const double y[])
{
    const size_t p = wrapper->p;
    const double *directions = wrapper->directions + (size_t)*parts->free * p * p;
    for (size_t i = 0; i < p; ++i) {
        if (*parts->begun == 0.0) parts->expected[i] = y[i] - parts->disturbance[i];
        parts->off[i] = y[i] - parts->expected[i] - parts->disturbance[i];
    }
    multiply(directions, parts->off, p, p, parts->correctable);
    for (size_t i = 0; i < p; ++i) {
        const bool grows = parts->correctable[i] * parts->disturbance[i] > 0.0;
        if (parts->cut_off[i] != 0.0 && grows) parts->correctable[i] = 0.0;
        parts->disturbance[i] += wrapper->gain * parts->correctable[i];
        parts->expected[i] += parts->off[i] - parts->correctable[i];
    }
}

Sample shift_references(const OffsetFree *wrapper, double memory[], const Sample *sample)
{
    const size_t p = wrapper->p, target = wrapper->horizon ? 1 : 0; /* the first that is to be reached */
    const Parts parts = parts_of(wrapper, memory);
    if (all_finite(sample->y, p)) estimate_disturbance(wrapper, &parts, sample->y);
    else if (*parts.begun == 0.0) memcpy(parts.expected, sample->setpoint, p * sizeof(double));
    for (size_t k = 0; k <= wrapper->horizon; ++k) {
        const double *reference = k ? sample->reference + (k - 1) * p : sample->setpoint;
        for (size_t i = 0; i < p; ++i) {
            const double wanted = reference[i] - parts.disturbance[i];
            const double shifted = clip(wanted, wrapper->y_min[i], wrapper->y_max[i]);
            parts.shifted[k * p + i] = shifted;
            if (k != target) continue;
            parts.cut_off[i] = shifted != wanted;
            parts.expected[i] = wrapper->phi * parts.expected[i] + (1.0 - wrapper->phi) * shifted;
        }
    }
    *parts.begun = all_finite(parts.expected, p); /* without a reference nothing is expected of the next sample */
    return (Sample){sample->y, sample->measured, parts.shifted + p, parts.shifted};
}

void remember_free(const OffsetFree *wrapper, double memory[], const double u[])
{
    size_t set = 0;
    for (size_t i = 0; i < wrapper->m; ++i) {
        if (u[i] > wrapper->low[i] && u[i] < wrapper->high[i]) set += (size_t)1 << i;
    }
    *parts_of(wrapper, memory).free = (double)set;
}
