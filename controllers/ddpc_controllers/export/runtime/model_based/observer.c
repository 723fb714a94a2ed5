#include "observer.h"

#include "vectors.h"

#include <math.h>
#include <string.h>

static const double *disturbances_now(const Observer *observer, const ObserverMemory *held)
{
    return held->scratch + observer->n + observer->p;
}

void expected_outputs(const Observer *observer, const ObserverMemory *held, double y[])
{
    const size_t p = observer->p, width = observer->disturbances;
    multiply(observer->c, held->state, p, observer->n, y);
    if (width) add_product(observer->f, disturbances_now(observer, held), p, width, y);
}

bool observe(const Observer *observer, const ObserverMemory *held, const Sample *sample, double u[], Told *told)
{
    const double *y = sample->y;
    const size_t m = observer->m, n = observer->n, p = observer->p, width = observer->disturbances;
    const bool missing = !all_finite(y, p);
    if (*held->resting != 0.0) {
        if (missing) {
            memcpy(u, held->u, m * sizeof(double));
            told->status |= STATUS_HELD;
            return false;
        }
        memcpy(held->scratch, y, p * sizeof(double));
        held->scratch[p] = 1.0;
        multiply(held->rest, held->scratch, n, p + 1, held->state);
        if (width) add_product(observer->rest_d, disturbances_now(observer, held), n, width, held->state);
        for (size_t j = 0; sample->applied != NULL && j < m; ++j) { /* it rests with these inputs */
            const double moved = sample->applied[j] - held->u[j];
            for (size_t i = 0; i < n; ++i) held->state[i] += observer->rest_u[i * m + j] * moved;
        }
        *held->resting = 0.0;
    }
    if (missing) told->status |= STATUS_EXPECTED;
    double *surprise = held->scratch;
    expected_outputs(observer, held, surprise);
    for (size_t i = 0; i < p; ++i) {
        surprise[i] = y[i] - surprise[i];
        if (!isfinite(surprise[i])) surprise[i] = 0.0;
    }
    add_product(observer->gain, surprise, n, p, held->state);
    return true;
}

void predict(const Observer *observer, const ObserverMemory *held, const double u[])
{
    const size_t n = observer->n, m = observer->m, width = observer->disturbances;
    multiply(observer->a, held->state, n, n, held->scratch);
    memcpy(held->state, held->scratch, n * sizeof(double));
    add_product(observer->b, u, n, m, held->state);
    if (width) add_product(observer->e, disturbances_now(observer, held), n, width, held->state);
    memcpy(held->u, u, m * sizeof(double));
}
