#include "observer.h"

#include "vectors.h"

#include <math.h>
#include <string.h>

bool observe(const Observer *observer, const ObserverMemory *held, const double y[], double u[], Told *told)
{
    const size_t m = observer->m, n = observer->n, p = observer->p;
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
        *held->resting = 0.0;
    }
    if (missing) told->status |= STATUS_EXPECTED;
    double *surprise = held->scratch;
    multiply(observer->c, held->state, p, n, surprise);
    for (size_t i = 0; i < p; ++i) {
        surprise[i] = y[i] - surprise[i];
        if (!isfinite(surprise[i])) surprise[i] = 0.0;
    }
    add_product(observer->gain, surprise, n, p, held->state);
    return true;
}

void predict(const Observer *observer, const ObserverMemory *held, const double u[])
{
    const size_t n = observer->n, m = observer->m;
    multiply(observer->a, held->state, n, n, held->scratch);
    memcpy(held->state, held->scratch, n * sizeof(double));
    add_product(observer->b, u, n, m, held->state);
    memcpy(held->u, u, m * sizeof(double));
}
