#include "sample.h"

#include <math.h>

void choose(const double values[], const size_t places[], size_t n, double chosen[])
{
    for (size_t i = 0; i < n; ++i) chosen[i] = values[places[i]];
}

void repeat_last(const double r[], size_t preview, size_t horizon, size_t p, double reference[])
{
    for (size_t k = 0; k < horizon; ++k) {
        const double *known = r + (k < preview ? k + 1 : preview) * p;
        for (size_t i = 0; i < p; ++i) reference[k * p + i] = known[i];
    }
}

bool take_applied(const double y[], double seen[], size_t n, const double u[], double applied[], size_t m, Told *told)
{
    bool known = true;
    for (size_t i = 0; i < n; ++i) {
        if (isfinite(y[i])) seen[i] = y[i];
        else told->status |= STATUS_LAST;
        known = known && isfinite(seen[i]);
    }
    for (size_t i = 0; i < m; ++i) {
        if (isfinite(u[i])) applied[i] = u[i];
        else told->status |= STATUS_HELD;
    }
    return known;
}

void hold_bounds(double u[], const double low[], const double high[], size_t m, double last[], Told *told)
{
    for (size_t i = 0; i < m; ++i) {
        if (!isfinite(u[i])) {
            u[i] = last[i];
            told->status |= STATUS_HELD;
        }
        u[i] = fmin(fmax(u[i], low[i]), high[i]);
        last[i] = u[i];
    }
}
