/* Co-Simulation: communication steps. */
#include "instance.h"

#include <math.h>

/* How far two times may lie apart that an importer computed in different ways (k * h, or h added k times). */
static double time_tolerance(double time, double step)
{
    return 1e-10 * fabs(time) + 1e-6 * step;
}

static const char *reason(Dopri54Result result)
{
    switch (result) {
    case DOPRI54_DONE: break;
    case DOPRI54_NOT_FINITE: return "a derivative is not finite";
    case DOPRI54_STEP_VANISHED: return "the tolerance needs internal steps below the resolution of time";
    case DOPRI54_TOO_MANY_STEPS: return "too many internal steps (stiff equations, or far too long a step)";
    }
    return "";
}

static Status check_step(const Instance *instance, double start, double size, const char *function)
{
    const double time = simulation_time(instance->simulation);
    if (!(size > 0.0 && isfinite(size))) {
        return refuse(instance, STATUS_ERROR, "%s: the communication step size %g is not positive and finite.",
                      function, size);
    }
    if (!(fabs(start - time) <= time_tolerance(time, size))) {
        return refuse(instance, STATUS_ERROR, "%s: the communication point is %.10g, the instance is at %.10g.",
                      function, start, time);
    }
    if (start + size > instance->stop_time + time_tolerance(instance->stop_time, size)) {
        return refuse(instance, STATUS_ERROR, "%s: the step ends at %.10g, after the stop time %.10g.", function,
                      start + size, instance->stop_time);
    }
    return STATUS_OK;
}

Status instance_do_step(Instance *instance, double start, double size, const char *function)
{
    if (!allowed(instance, MODE_STEP, function)) return STATUS_ERROR;
    const Status checked = check_step(instance, start, size, function);
    if (checked != STATUS_OK) return checked;

    const Advance advance = simulation_advance(instance->simulation, start, size);
    if (advance.result == DOPRI54_DONE) return STATUS_OK;
    instance->mode = MODE_ERROR;
    return refuse(instance, STATUS_ERROR, "%s: the integration failed at time %.10g: %s.", function, advance.time,
                  reason(advance.result));
}
