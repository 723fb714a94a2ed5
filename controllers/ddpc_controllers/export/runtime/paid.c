#include "paid.h"

#include <string.h>

Sample with_paid(const Paid *paid, const Sample *sample, double memory[])
{
    const size_t p = paid->p, width = p + paid->more;
    double *y = memory, *setpoint = y + width, *reference = setpoint + width;
    memcpy(y, sample->y, p * sizeof(double));
    choose(sample->measured, paid->measured, paid->more, y + p);
    memcpy(setpoint, sample->setpoint, p * sizeof(double));
    for (size_t k = 0; k < paid->horizon; ++k)
        memcpy(reference + k * width, sample->reference + k * p, p * sizeof(double));
    return (Sample){y, sample->measured, reference, setpoint, sample->applied};
}
