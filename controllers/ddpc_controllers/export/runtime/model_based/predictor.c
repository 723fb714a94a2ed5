#include "predictor.h"

#include "vectors.h"

#include <string.h>

void solve_predictor(const Predictor *predictor, const double state[], const double last[], const double reference[],
                     double memory[], double u[], Told *told)
{
    const size_t n = predictor->n, m = predictor->m, references = predictor->references;
    double *parameters = memory;
    memcpy(parameters, state, n * sizeof(double));
    memcpy(parameters + n, last, m * sizeof(double));
    memcpy(parameters + n + m, reference, references * sizeof(double));
    parameters[n + m + references] = 1.0;
    if (!solve_law(predictor->law, parameters, parameters + n + m + references + 1, u, told)) {
        memcpy(u, last, m * sizeof(double));
        return;
    }
    for (size_t i = 0; i < m; ++i) {
        u[i] = clip(u[i], last[i] - predictor->rates[i], last[i] + predictor->rates[i]);
        u[i] = clip(u[i], predictor->low[i], predictor->high[i]);
    }
}
