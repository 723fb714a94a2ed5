/* The dual active-set method of D. Goldfarb and A. Idnani (Math. Programming 27 (1983) 1-33) for a cost |t|^2:
 * from the optimum on some of the limits to that on more of them, until all are kept. Where a new row depends on
 * the active ones, the step of D. Arnstroem, A. Bemporad and D. Axehill (IEEE TAC 67 (2022) 4362-4369,
 * doi:10.1109/TAC.2022.3176430) goes on, or proves that the limits contradict each other.
 *
 * The normals of the active limits, outwards, are the columns of A = Q R: Q orthonormal, made by twice repeated
 * Gram-Schmidt, R upper triangular. With e what they are exceeded by at t = 0 and the multipliers mu,
 *
 *     R' y = e,   t = -Q y,   R mu = y.
 *
 * No product A'A is formed: nearly dependent limits keep half of the digits that they would lose there. */
#include "qp.h"

#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>

#include "vectors.h"

/* A new row depends on the active ones where less than this is left of it, */
static const double DEPENDENT = 1e-12;
/* or less than this in parts of its share in one of them: its direction would be rounding, */
static const double LOST = 64.0 * DBL_EPSILON;
/* or so little that the next step would be longer than t is by more than the inverse of this. */
static const double REMOTE = 1e-7;
/* What of a row's combination counts as zero. */
static const double INSIGNIFICANT = 1e-9;
/* Rounding of a row's value in parts of its terms. */
static const double ROUNDING = 1e-13;
/* Q is made anew after so many rotations. */
static const double ROTATIONS = 100.0;

/* The parts of the memory. */
typedef struct {
    double *count, *rotated;
    double *numbers;     /* 1 + number of each active row, negative at its lower limit */
    double *multipliers;
    double *y, *wanted, *combination, *rest;
    double *q;           /* columns of Q one after another */
    double *r;           /* column j of R, j + 1 entries, after those before */
} Set;

static Set parts_of(double memory[], size_t k)
{
    Set set;
    set.count = memory;
    set.rotated = memory + 1;
    set.numbers = memory + 2;
    set.multipliers = set.numbers + k;
    set.y = set.multipliers + k;
    set.wanted = set.y + k;
    set.combination = set.wanted + k;
    set.rest = set.combination + k;
    set.q = set.rest + k;
    set.r = set.q + k * k;
    return set;
}

static size_t size_of(const Set *set)
{
    return (size_t)*set->count;
}

static double *column(const Set *set, size_t j)
{
    return set->r + j * (j + 1) / 2;
}

static size_t row_of(double number)
{
    return (size_t)fabs(number) - 1;
}

static double sign_of(double number)
{
    return number < 0.0 ? -1.0 : 1.0;
}

/* Return by how much an active limit is exceeded at t = 0. */
static double excess(const QP *qp, double number)
{
    const size_t i = row_of(number);
    return number < 0.0 ? qp->lower[i] - qp->value[i] : qp->value[i] - qp->upper[i];
}

/* Solve R x = b in place. */
static void solve_upper(const Set *set, double x[])
{
    for (size_t j = size_of(set); j-- > 0;) {
        const double *entries = column(set, j);
        x[j] /= entries[j];
        for (size_t i = 0; i < j; ++i) x[i] -= entries[i] * x[j];
    }
}

/* Solve R' x = b in place. */
static void solve_lower(const Set *set, double x[])
{
    for (size_t j = 0; j < size_of(set); ++j) {
        const double *entries = column(set, j);
        x[j] = (x[j] - dot(entries, x, j)) / entries[j];
    }
}

/* Add a limit unless its row depends on the active ones; as little as `remote` does not count. `combination` receives
 * the shares of the active normals in its own. */
static bool append(const QP *qp, const Set *set, double number, double remote)
{
    const size_t k = qp->size, n = size_of(set);
    const double *row = qp->rows + row_of(number) * k;
    double *rest = set->rest, *entries = column(set, n);
    for (size_t i = 0; i < k; ++i) rest[i] = sign_of(number) * row[i];
    memset(set->combination, 0, n * sizeof(double));
    for (int pass = 0; pass < 2; ++pass) {
        for (size_t j = 0; j < n; ++j) {
            const double *q = set->q + j * k;
            const double share = dot(q, rest, k);
            for (size_t i = 0; i < k; ++i) rest[i] -= share * q[i];
            set->combination[j] += share;
        }
    }
    const double norm = sqrt(dot(rest, rest, k));
    double largest = 1.0;
    if (n < k) memcpy(entries, set->combination, n * sizeof(double));
    solve_upper(set, set->combination);
    for (size_t j = 0; j < n; ++j) largest = fmax(largest, fabs(set->combination[j]));
    if (n == k || !(norm > fmax(fmax(DEPENDENT, remote), LOST * largest))) return false;
    entries[n] = norm;
    for (size_t i = 0; i < k; ++i) set->q[n * k + i] = rest[i] / norm;
    set->numbers[n] = number;
    set->multipliers[n] = 0.0;
    *set->count += 1.0;
    return true;
}

/* Let go of the active limit j: rotations make R triangular again. */
static void release(const Set *set, size_t j, size_t k)
{
    const size_t n = size_of(set) - 1;
    for (size_t i = j; i < n; ++i) {
        double *entries = column(set, i + 1), *q = set->q + i * k;
        const double size = hypot(entries[i], entries[i + 1]);
        const double c = entries[i] / size, s = entries[i + 1] / size;
        for (size_t next = i + 1; next <= n; ++next) {
            double *pair = column(set, next) + i;
            const double upper = pair[0], lower = pair[1];
            pair[0] = c * upper + s * lower;
            pair[1] = c * lower - s * upper;
        }
        for (size_t l = 0; l < k; ++l) {
            const double first = q[l], second = q[k + l];
            q[l] = c * first + s * second;
            q[k + l] = c * second - s * first;
        }
        memcpy(column(set, i), entries, (i + 1) * sizeof(double));
        set->numbers[i] = set->numbers[i + 1];
        set->multipliers[i] = set->multipliers[i + 1];
    }
    *set->count -= 1.0;
    *set->rotated += 1.0;
}

/* Compute the optimum t with the active limits as equations, and their multipliers. */
static void optimise(const QP *qp, const Set *set, double t[])
{
    const size_t k = qp->size, n = size_of(set);
    memset(t, 0, k * sizeof(double));
    memset(set->wanted, 0, n * sizeof(double));
    for (int pass = 0; pass < 2; ++pass) { /* the second removes the rounding of the first */
        for (size_t j = 0; j < n; ++j) {
            const double number = set->numbers[j];
            set->y[j] = excess(qp, number) + sign_of(number) * dot(qp->rows + row_of(number) * k, t, k);
        }
        solve_lower(set, set->y);
        for (size_t j = 0; j < n; ++j) {
            const double *q = set->q + j * k;
            for (size_t i = 0; i < k; ++i) t[i] -= set->y[j] * q[i];
            set->wanted[j] += set->y[j];
        }
    }
    solve_upper(set, set->wanted);
}

/* Move the multipliers towards those wanted; return the first that would change its sign, n if there is none. */
static size_t move(const Set *set)
{
    const size_t n = size_of(set);
    size_t first = n;
    double share = 1.0;
    for (size_t j = 0; j < n; ++j) {
        if (set->wanted[j] < 0.0) {
            const double own = set->multipliers[j] / (set->multipliers[j] - set->wanted[j]);
            if (first == n || own < share) {
                first = j;
                share = own;
            }
        }
    }
    for (size_t j = 0; j < n; ++j) set->multipliers[j] += share * (set->wanted[j] - set->multipliers[j]);
    return first;
}

/* Return the number of the limit that t exceeds most, 0 if it keeps all. `remote` receives what has to be left of its
 * row for a step that is not too long. */
static double most_exceeded(const QP *qp, const double t[], double *remote)
{
    const size_t k = qp->size;
    const double size = sqrt(dot(t, t, k));
    double worst = 0.0, number = 0.0;
    for (size_t i = 0; i < qp->count; ++i) {
        const double value = qp->value[i] + dot(qp->rows + i * k, t, k);
        const double above = value - qp->upper[i], below = qp->lower[i] - value;
        const double beyond = above > below ? above : below;
        if (beyond > worst && beyond > qp->tolerance[i] + ROUNDING * (fabs(qp->value[i]) + size)) {
            worst = beyond;
            number = above > below ? (double)(i + 1) : -(double)(i + 1);
        }
    }
    *remote = REMOTE * worst / fmax(size, worst);
    return number;
}

/* Make room for a limit whose row depends on the active ones: `multiplier` is its own. False where no step along
 * the dependence ends: by Farkas' lemma the limits contradict each other. */
static bool exchange(const Set *set, double *multiplier, size_t k)
{
    const size_t n = size_of(set);
    double *combination = set->combination, step = INFINITY, largest = 1.0;
    size_t first = n;
    for (size_t j = 0; j < n; ++j) largest = fmax(largest, fabs(combination[j]));
    for (size_t j = 0; j < n; ++j) {
        if (combination[j] > INSIGNIFICANT * largest && set->multipliers[j] < step * combination[j]) {
            first = j;
            step = set->multipliers[j] / combination[j];
        }
    }
    if (first == n) return false;
    for (size_t j = 0; j < n; ++j) {
        set->multipliers[j] = fmax(set->multipliers[j] - step * combination[j], 0.0);
    }
    *multiplier += step;
    release(set, first, k);
    return true;
}

QPResult qp_solve(const QP *qp, double memory[], double t[], unsigned *iterations)
{
    const Set set = parts_of(memory, qp->size);
    const unsigned last = *iterations + (unsigned)QP_LIMIT(qp->count, qp->size);
    if (*set.rotated > ROTATIONS) qp_refactor(qp, memory);
    while (*iterations < last) {
        optimise(qp, &set, t);
        const size_t blocking = move(&set);
        if (blocking < size_of(&set)) {
            release(&set, blocking, qp->size);
            ++*iterations;
            continue;
        }
        double remote = 0.0, multiplier = 0.0;
        const double number = most_exceeded(qp, t, &remote);
        if (number == 0.0) return QP_SOLVED;
        while (!append(qp, &set, number, remote)) {
            if (!exchange(&set, &multiplier, qp->size)) return QP_INFEASIBLE;
            ++*iterations;
        }
        set.multipliers[size_of(&set) - 1] = multiplier;
        ++*iterations;
    }
    *set.count = 0.0;
    return QP_EXCEEDED;
}

unsigned qp_active(const double memory[])
{
    return (unsigned)memory[0];
}

void qp_refactor(const QP *qp, double memory[])
{
    const Set set = parts_of(memory, qp->size);
    const size_t n = size_of(&set);
    *set.count = *set.rotated = 0.0;
    for (size_t j = 0; j < n; ++j) { /* no number is overwritten before it is read */
        const double multiplier = set.multipliers[j];
        if (append(qp, &set, set.numbers[j], 0.0)) set.multipliers[size_of(&set) - 1] = multiplier;
    }
}
