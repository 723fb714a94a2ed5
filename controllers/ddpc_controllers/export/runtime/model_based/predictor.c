#include "predictor.h"

#include "ahead.h"
#include "vectors.h"

#include <string.h>

void solve_predictor(const Predictor *predictor, const double state[], const double last[], const double reference[],
                     double memory[], double u[], Told *told)
{
    const size_t n = predictor->n, m = predictor->m, references = predictor->references;
    const size_t one = n + m + references + predictor->ahead;
    const double *low = predictor->low, *high = predictor->high;
    double *parameters = memory;
    memcpy(parameters, state, n * sizeof(double));
    memcpy(parameters + n, last, m * sizeof(double));
    memcpy(parameters + n + m, reference, references * sizeof(double));
    parameters[one] = 1.0;
    double *after = parameters + one + 1;
    if (predictor->near) {
        low = after;
        high = low + m;
        after += 2 * m;
    }
    if (!solve_law(predictor->law, parameters, after, u, told)) {
        memcpy(u, last, m * sizeof(double));
        return;
    }
    if (predictor->near) keep_limits(u, low, m, predictor->near, m);
    for (size_t i = 0; i < m; ++i) {
        u[i] = clip(u[i], last[i] - predictor->rates[i], last[i] + predictor->rates[i]);
        u[i] = clip(u[i], low[i], high[i]);
    }
}
