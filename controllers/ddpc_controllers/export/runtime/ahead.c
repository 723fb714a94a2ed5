#include "ahead.h"

#include <math.h>

/* An edge or a limit this far off is none: where infinite numbers cannot be told. */
static const double NONE = 1e30;

void take_known(const Known *known, const double values[], double ahead[])
{
    for (size_t i = 0; i < known->n; ++i) {
        const double value = values[known->places[i]];
        ahead[known->places[i]] = isnan(value) ? ahead[known->before[i]] : value;
    }
}

void choose_ahead(const Chosen *chosen, const double ahead[], double values[])
{
    for (size_t i = 0; i < chosen->n; ++i) {
        const double value = chosen->factors[i] * ahead[chosen->places[i]];
        values[i] = fabs(value) >= NONE ? copysign(chosen->far, value) : value;
    }
}

void keep_limits(double u[], const double limits[], size_t n, const double near[], size_t m)
{
    for (size_t i = 0; i < n; ++i) {
        const double low = limits[i], high = limits[n + i], margin = near[i % m];
        if (u[i] <= low + margin) u[i] = low;
        else if (u[i] >= high - margin) u[i] = high;
    }
}
