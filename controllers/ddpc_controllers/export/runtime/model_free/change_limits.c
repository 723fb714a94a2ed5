#include "change_limits.h"

#include "qp.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

static const double ROUNDING = 1e-12;
static const double AT_LIMIT = 1e-9;

bool factorise(const double matrix[], double factor[], size_t n)
{
    for (size_t i = 0; i < n; ++i) {
        for (size_t j = 0; j <= i; ++j) {
            const double rest = matrix[i * n + j] - dot(factor + i * n, factor + j * n, j);
            if (j < i) factor[i * n + j] = rest / factor[j * n + j];
            else if (rest > 0.0) factor[i * n + i] = sqrt(rest);
            else return false;
        }
    }
    return true;
}

/* Whether the whole plan keeps the limits. */
static bool admits(const ChangeLimits *limits, const double bounds[], const double last[], const double plan[])
{
    for (size_t j = 0; j < limits->m; ++j) {
        double level = last[j];
        for (size_t k = 0; k < limits->steps; ++k) {
            const double change = plan[k * limits->m + j];
            level += change;
            if (level < bounds[j] || level > bounds[limits->m + j] || fabs(change) > limits->rates[j]) return false;
        }
    }
    return true;
}

/* One limited value in terms of t = L' (x - free), x the changes in parts of their spans, L `factor`. */
static void limit_row(const ChangeLimits *limits, const ChangeLimitsMemory *held, const double last[],
                      const double plan[], size_t limited)
{
    const size_t m = limits->m, n = limits->steps * m, at = limited % n, j = at % m;
    const bool is_level = limited < n;
    const double span = limits->spans[j], *factor = held->factor;
    double *row = held->rows + limited * n, value = 0.0;
    memset(row, 0, n * sizeof(double));
    for (size_t i = is_level ? j : at; i <= at; i += m) {
        row[i] = 1.0;
        value += plan[i] / span;
    }
    for (size_t i = 0; i < n; ++i) { /* L^-1 row */
        row[i] = (row[i] - dot(factor + i * n, row, i)) / factor[i * n + i];
    }
    const double norm = sqrt(dot(row, row, n));
    for (size_t i = 0; i < n; ++i) row[i] /= norm;
    held->value[limited] = value / norm;
    held->lower[limited] = (is_level ? held->bounds[j] - last[j] : -limits->rates[j]) / (span * norm);
    held->upper[limited] = (is_level ? held->bounds[m + j] - last[j] : limits->rates[j]) / (span * norm);
    held->tolerance[limited] = ROUNDING / norm;
}

/* The best plan that keeps the limits; it stays as it is, with a status, where there is none. */
static void optimise(const ChangeLimits *limits, const ChangeLimitsMemory *held, const double last[], double plan[],
                     const double hessian[], Told *told)
{
    const size_t m = limits->m, n = limits->steps * m, limited = limits->rated ? 2 * n : n;
    double *scaled = held->rows, largest = 0.0;
    for (size_t i = 0; i < n * n; ++i) {
        scaled[i] = hessian[i] * limits->spans[i / n % m] * limits->spans[i % m];
        largest = fmax(largest, fabs(scaled[i]));
    }
    for (size_t i = 0; i < n * n; ++i) scaled[i] /= largest;
    if (!factorise(scaled, held->factor, n)) {
        for (size_t i = 0; i < n; ++i) scaled[i * (n + 1)] += ROUNDING;
        if (!factorise(scaled, held->factor, n)) {
            told->status |= STATUS_CLIPPED;
            return;
        }
    }
    for (size_t i = 0; i < limited; ++i) limit_row(limits, held, last, plan, i);
    const QP qp = {limited, n, held->rows, held->value, held->lower, held->upper, held->tolerance};
    memset(held->qp, 0, QP_MEMORY(n) * sizeof(double));
    const QPResult result = qp_solve(&qp, held->qp, held->t, &told->iterations);
    if (result != QP_SOLVED) {
        told->status |= result == QP_EXCEEDED ? STATUS_CLIPPED | STATUS_ITERATIONS : STATUS_CLIPPED;
        return;
    }
    for (size_t i = n; i-- > 0;) { /* L^-T t */
        for (size_t l = i + 1; l < n; ++l) held->t[i] -= held->factor[l * n + i] * held->t[l];
        held->t[i] /= held->factor[i * n + i];
        plan[i] += held->t[i] * limits->spans[i % m];
    }
}

/* At how many limits the changes are. */
static unsigned reached(const ChangeLimits *limits, const double bounds[], const double last[], const double plan[])
{
    unsigned count = 0;
    for (size_t j = 0; j < limits->m; ++j) {
        const double near = AT_LIMIT * limits->spans[j];
        double level = last[j];
        for (size_t k = 0; k < (limits->optimise ? limits->steps : 1); ++k) {
            const double change = plan[k * limits->m + j];
            level += change;
            count += level <= bounds[j] + near;
            count += level >= bounds[limits->m + j] - near;
            count += fabs(change) >= limits->rates[j] - near;
        }
    }
    return count;
}

void limit_changes(const ChangeLimits *limits, const ChangeLimitsMemory *held, const double last[], double plan[],
                   const double hessian[], double u[], Told *told)
{
    const size_t m = limits->m;
    const double *const bounds = held->bounds;
    if (!all_finite(plan, limits->steps * m)) {
        memcpy(u, last, m * sizeof(double));
        told->status |= STATUS_HELD;
        return;
    }
    if (limits->optimise && !admits(limits, bounds, last, plan)) optimise(limits, held, last, plan, hessian, told);
    for (size_t j = 0; j < m; ++j) {
        const double change = clip(plan[j], -limits->rates[j], limits->rates[j]);
        u[j] = clip(last[j] + change, bounds[j], bounds[m + j]);
        plan[j] = u[j] - last[j];
    }
    told->active_bounds += reached(limits, bounds, last, plan);
}
