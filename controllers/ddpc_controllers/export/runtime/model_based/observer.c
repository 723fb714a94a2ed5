#include "observer.h"

#include "vectors.h"

#include <math.h>
#include <string.h>

Estimate estimate_in(const Observer *observer, double memory[])
{
    double *u = memory + 1, *state = u + observer->m;
    return (Estimate){memory, u, state, state + observer->n};
}

bool observe(const Observer *observer, Estimate estimate, const double y[], double u[], Told *told)
{
    const size_t m = observer->m, n = observer->n, p = observer->p;
    const bool missing = !all_finite(y, p);
    if (estimate.resting[0] != 0.0) {
        if (missing) {
            memcpy(u, estimate.u, m * sizeof(double));
            told->status |= STATUS_HELD;
            return false;
        }
        memcpy(estimate.scratch, y, p * sizeof(double));
        estimate.scratch[p] = 1.0;
        multiply(observer->rest, estimate.scratch, n, p + 1, estimate.state);
        estimate.resting[0] = 0.0;
    }
    if (missing) told->status |= STATUS_EXPECTED;
    double *surprise = estimate.scratch;
    multiply(observer->c, estimate.state, p, n, surprise);
    for (size_t i = 0; i < p; ++i) {
        surprise[i] = y[i] - surprise[i];
        if (!isfinite(surprise[i])) surprise[i] = 0.0;
    }
    add_product(observer->gain, surprise, n, p, estimate.state);
    return true;
}

void predict(const Observer *observer, Estimate estimate, const double u[])
{
    const size_t n = observer->n, m = observer->m;
    multiply(observer->a, estimate.state, n, n, estimate.scratch);
    memcpy(estimate.state, estimate.scratch, n * sizeof(double));
    add_product(observer->b, u, n, m, estimate.state);
    memcpy(estimate.u, u, m * sizeof(double));
}
