#include "regulator.h"

#include "vectors.h"

#include <math.h>
#include <string.h>

void regulate(const Regulator *regulator, const ObserverMemory *held, double sums[], double scratch[], const Sample *sample,
              double u[], Told *told)
{
    const Observer *observer = regulator->observer;
    const size_t m = observer->m, n = observer->n, p = observer->p;
    double *sum = sums + 1, *wanted = scratch, *y = scratch + m, *ahead = y + p;
    const double *low = regulator->low, *high = regulator->high;
    if (regulator->moves) {
        low = ahead + regulator->ahead;
        high = low + m;
    }
    if (sample->applied != NULL) { /* the disturbances last, as far as the last inputs knew */
        for (size_t i = observer->disturbances; i < regulator->ahead; ++i) ahead[i] = ahead[i - observer->disturbances];
    }
    multiply(regulator->state_gain, held->state, m, n, wanted);
    for (size_t i = 0; i < m; ++i) wanted[i] = regulator->u_0[i] - wanted[i];
    if (regulator->ahead) add_product(regulator->feedforward, ahead, m, regulator->ahead, wanted);
    const double *last = sample->applied != NULL ? sample->applied : held->u;
    for (size_t i = 0; i < m; ++i) u[i] = wanted[i] - last[i];
    if (sample->applied != NULL) { /* as if these inputs had been its own */
        multiply(regulator->sums_of_inputs, u, p, m, sum);
        sums[0] = 1.0;
        memcpy(u, sample->applied, m * sizeof(double));
        return;
    }
    if (sums[0] == 0.0) { /* the loop closes without a bump */
        multiply(regulator->sums_of_inputs, u, p, m, sum);
        sums[0] = 1.0;
    }
    expected_outputs(observer, held, y);
    for (size_t i = 0; i < p; ++i) {
        const double error = (isfinite(sample->y[i]) ? sample->y[i] : y[i]) - sample->reference[i];
        if (isfinite(error)) sum[i] += error;
        else told->status |= STATUS_HELD;
    }
    for (size_t i = 0; i < m; ++i) {
        wanted[i] -= dot(regulator->sum_gain + i * p, sum, p);
        u[i] = clip(wanted[i], low[i], high[i]);
        wanted[i] -= u[i];
    }
    add_product(regulator->sums_of_inputs, wanted, p, m, sum);
}
