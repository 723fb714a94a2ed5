#include "law.h"

#include <math.h>
#include <string.h>

#include "vectors.h"

/* What must vanish may be so large, in parts of what the recorded windows hold, or of its terms. */
static const double NO_CONFLICT = 1e-6;

static bool has_conflict(const Law *law, const double p[])
{
    const double *rows = law->law + (law->bounds + law->answers) * law->parameters;
    double size = 0.0, terms = 0.0;
    for (size_t i = 0; i < law->conflicts; ++i) {
        const double *row = rows + i * law->parameters;
        double sum = 0.0;
        for (size_t j = 0; j < law->parameters; ++j) sum += fabs(row[j]) * fabs(p[j]);
        size = fmax(size, fabs(dot(row, p, law->parameters)));
        terms = fmax(terms, sum);
    }
    return size > NO_CONFLICT && size > NO_CONFLICT * terms;
}

static bool keeps_bounds(const Law *law, const double value[])
{
    for (size_t i = 0; i < law->bounds; ++i) {
        if (value[i] > 0.0 || value[i] < law->lower[i]) return false;
    }
    return true;
}

/* Inputs that are at a limit but for rounding are exactly there. */
static void reach_limits(const Law *law, double answer[])
{
    for (size_t i = 0; i < law->inputs; ++i) {
        if (answer[i] <= law->near_low[i]) answer[i] = law->low[i];
        else if (answer[i] >= law->near_high[i]) answer[i] = law->high[i];
    }
}

static void hold_limits(const Law *law, double answer[])
{
    for (size_t i = 0; i < law->inputs; ++i) answer[i] = clip(answer[i], law->low[i], law->high[i]);
}

/* Correct the unconstrained optimum; false if there is no optimum that keeps the bounds. */
static bool correct(const Law *law, const double value[], double memory[], double answer[], Told *told)
{
    double *tolerance = memory, *t = tolerance + law->bounds, *method = t + law->size;
    const QP qp = {law->bounds, law->size, law->gain, value, law->lower, law->upper, tolerance};
    for (size_t i = 0; i < law->bounds; ++i) tolerance[i] = law->tolerance * law->scale[i];
    const QPResult result = qp_solve(&qp, method, t, &told->iterations);
    if (result == QP_EXCEEDED) told->status |= STATUS_ITERATIONS;
    if (result != QP_SOLVED) return false;
    told->active_bounds += qp_active(method);
    add_product(law->gain + law->bounds * law->size, t, law->answers, law->size, answer);
    return true;
}

bool solve_law(const Law *law, const double p[], double memory[], double answer[], Told *told)
{
    bool relaxed = false;
    for (; law; law = law->easier) {
        double *value = memory;
        multiply(law->law, p, law->bounds, law->parameters, value);
        for (size_t i = 0; i < law->bounds; ++i) value[i] *= law->scale[i];
        multiply(law->law + law->bounds * law->parameters, p, law->answers, law->parameters, answer);
        if (!all_finite(value, law->bounds) || !all_finite(answer, law->answers)) break;
        bool met = keeps_bounds(law, value);
        if (!met) {
            met = correct(law, value, value + law->bounds, answer, told);
            reach_limits(law, answer);
        }
        if (met || !law->easier) {
            hold_limits(law, answer);
            if (!met) told->status |= STATUS_CLIPPED;
            else if (relaxed) told->status |= STATUS_RELAXED;
            else if (has_conflict(law, p)) told->status |= STATUS_NEAREST;
            return true;
        }
        memory += LAW_MEMORY(law->bounds, law->size);
        relaxed = true;
    }
    told->status |= STATUS_HELD;
    return false;
}
