#include "change_limits.h"

#include "qp.h"
#include "vectors.h"

#include <math.h>
#include <string.h>

static const double ROUNDING = 1e-12;
static const double AT_LIMIT = 1e-9;

bool factorise(const double matrix[], double factor[], size_t n)
{
    for (size_t j = 0; j < n; ++j) {
        const double *own = factor + j * n;
        const double rest = matrix[j * n + j] - dot(own, own, j);
        if (!(rest > 0.0)) return false;
        const double diagonal = factor[j * n + j] = sqrt(rest);
        for (size_t i = j + 1; i < n; ++i) /* down the column: none waits for another */
            factor[i * n + j] = (matrix[i * n + j] - dot(factor + i * n, own, j)) / diagonal;
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

/* The limited values in terms of t = L' (x - free), x the changes in parts of their spans, L `factor`. */
static void limit_rows(const ChangeLimits *limits, const ChangeLimitsMemory *held, const double last[],
                       const double plan[], size_t limited)
{
    const size_t m = limits->m, n = limits->steps * m;
    const double *factor = held->factor;
    memset(held->rows, 0, limited * n * sizeof(double));
    for (size_t l = 0; l < limited; ++l) {
        const size_t at = l % n, j = at % m;
        double value = 0.0;
        for (size_t i = l < n ? j : at; i <= at; i += m) {
            held->rows[l * n + i] = 1.0;
            value += plan[i] / limits->spans[j];
        }
        held->value[l] = value;
    }
    for (size_t i = 0; i < n; ++i) { /* L^-1 row, of all of them at once: none waits for another */
        for (size_t l = 0; l < limited; ++l) {
            double *row = held->rows + l * n;
            row[i] = (row[i] - dot(factor + i * n, row, i)) / factor[i * n + i];
        }
    }
    for (size_t l = 0; l < limited; ++l) {
        const size_t j = l % m;
        const bool is_level = l < n;
        const double span = limits->spans[j];
        double *row = held->rows + l * n;
        const double norm = sqrt(dot(row, row, n));
        for (size_t i = 0; i < n; ++i) row[i] /= norm;
        held->value[l] /= norm;
        held->lower[l] = (is_level ? held->bounds[j] - last[j] : -limits->rates[j]) / (span * norm);
        held->upper[l] = (is_level ? held->bounds[m + j] - last[j] : limits->rates[j]) / (span * norm);
        held->tolerance[l] = ROUNDING / norm;
    }
}

/* The best plan that keeps the limits; it stays as it is, with a status, where there is none. */
static void optimise(const ChangeLimits *limits, const ChangeLimitsMemory *held, const double last[], double plan[],
                     const double hessian[], Told *told)
{
    const size_t m = limits->m, n = limits->steps * m, limited = limits->rated ? 2 * n : n;
    double *scaled = held->rows, largest = 0.0;
    for (size_t i = 0; i < n; ++i) {
        for (size_t j = 0; j <= i; ++j) {
            scaled[i * n + j] = hessian[i * n + j] * limits->spans[i % m] * limits->spans[j % m];
            largest = fmax(largest, fabs(scaled[i * n + j]));
        }
    }
    for (size_t i = 0; i < n; ++i)
        for (size_t j = 0; j <= i; ++j) scaled[i * n + j] /= largest;
    if (!factorise(scaled, held->factor, n)) {
        for (size_t i = 0; i < n; ++i) scaled[i * (n + 1)] += ROUNDING;
        if (!factorise(scaled, held->factor, n)) {
            told->status |= STATUS_CLIPPED;
            return;
        }
    }
    limit_rows(limits, held, last, plan, limited);
    const QP qp = {limited, n, held->rows, held->value, held->lower, held->upper, held->tolerance};
    qp_refactor(&qp, held->qp); /* the limits that were reached last are the first guess */
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
