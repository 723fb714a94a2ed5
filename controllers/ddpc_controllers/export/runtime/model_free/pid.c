#include "pid.h"

#include "vectors.h"

#include <math.h>
#include <string.h>

static double kept(const PID *pid, size_t loop, double increment, double excess)
{
    if (pid->clamping) return increment * excess < 0.0 ? 0.0 : increment;
    return increment + pid->tracking[loop] * excess;
}

/* Let the lags of the disturbances go on by one sample; return the first of them. */
static const double *lag_disturbances(const PID *pid, double now[], bool first)
{
    const size_t width = pid->disturbances;
    double *begin = now + width, *lags = begin + width;
    if (first) memcpy(begin, now, width * sizeof(double));
    for (size_t j = 0; j < pid->lags; ++j) {
        for (size_t i = 0; i < width; ++i) {
            double *lag = lags + j * width + i;
            *lag = pid->poles[j] * *lag + (1.0 - pid->poles[j]) * (now[i] - begin[i]);
        }
    }
    return lags;
}

static double rate_of_change(const PID *pid, const PIDMemory *held, size_t i, double y)
{
    const double filter = pid->filter_time[i];
    return (filter * held->rate[i] - pid->derivative[i] * (y - held->before[i])) / (filter + *held->elapsed);
}

/* Take the outputs of a plant that is driven by somebody else. */
static void follow(const PID *pid, const PIDMemory *held, const double y[])
{
    for (size_t i = 0; i < pid->p; ++i) {
        if (held->begun[1] == 0.0) held->before[i] = y[i];
        held->rate[i] = rate_of_change(pid, held, i, y[i]);
        held->before[i] = y[i];
    }
    held->begun[0] = -1.0;
    held->begun[1] = 1.0;
}

/* The integral with which the last inputs were its own, for the reference of this sample. */
static void take_over(const PID *pid, const PIDMemory *held, const Sample *sample, const double lags[])
{
    const size_t lagged = pid->lags * pid->disturbances;
    for (size_t i = 0; i < pid->p; ++i) {
        const double added = lagged ? dot(pid->forward + i * lagged, lags, lagged) : 0.0;
        const double r = isfinite(sample->setpoint[i]) ? sample->setpoint[i] : sample->reference[i];
        const double error = pid->setpoint_share * r - held->before[i];
        held->bias[i] = held->u[pid->inputs[i]] - held->rate[i] - added - pid->proportional[i] * error;
    }
    held->begun[0] = 1.0;
}

void pid_step(const PID *pid, const PIDMemory *held, const Sample *sample, double u[], Told *told)
{
    const double *y = sample->y, *r = sample->reference, *low = pid->low, *high = pid->high;
    double *now = held->rate + pid->p;
    const size_t lagged = pid->lags * pid->disturbances;
    if (sample->applied == NULL && (!all_finite(y, pid->p) || !all_finite(r, pid->p))) {
        *held->elapsed += pid->sampling_time;
        memcpy(u, held->u, pid->m * sizeof(double));
        told->status |= STATUS_HELD;
        return;
    }
    if (pid->moves) {
        low = now;
        high = low + pid->p;
        now += 2 * pid->p;
    }
    double *begin = now + pid->disturbances;
    if (sample->applied == NULL && held->begun[0] < 0.0) take_over(pid, held, sample, begin + pid->disturbances);
    const double *lags = lagged ? lag_disturbances(pid, now, held->begun[0] == 0.0) : now;
    if (sample->applied != NULL) {
        follow(pid, held, y);
        memcpy(held->u, sample->applied, pid->m * sizeof(double));
        memcpy(u, sample->applied, pid->m * sizeof(double));
        return;
    }
    for (size_t i = 0; i < pid->p; ++i) {
        double *input = held->u + pid->inputs[i];
        const double share = pid->setpoint_share, gain = pid->proportional[i];
        if (held->begun[0] == 0.0) held->bias[i] = *input + gain * (1.0 - share) * y[i];
        if (held->begun[1] == 0.0) held->before[i] = y[i];
        held->rate[i] = rate_of_change(pid, held, i, y[i]);
        const double increment = pid->sampling_time * pid->integral[i] * (r[i] - y[i]);
        const double added = lagged ? dot(pid->forward + i * lagged, lags, lagged) : 0.0;
        const double wanted = gain * (share * r[i] - y[i]) + held->bias[i] + increment + held->rate[i] + added;
        const double limited = clip(wanted, low[i], high[i]);
        held->bias[i] += kept(pid, i, increment, limited - wanted);
        held->before[i] = y[i];
        *input = limited;
    }
    held->begun[0] = held->begun[1] = 1.0;
    *held->elapsed = pid->sampling_time;
    memcpy(u, held->u, pid->m * sizeof(double));
}
