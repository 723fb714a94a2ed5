/* FMI 2.0 for Co-Simulation: communication steps and their status (section 4.2). */
#include "fmi2_instance.h"

#include <math.h>

/* How far two times may lie apart that an importer computed in different ways (k * h, or h added k times). */
static double time_tolerance(double time, double step)
{
    return 1e-10 * fabs(time) + 1e-6 * step;
}

static const char *reason(Dopri54Result result)
{
    switch (result) {
    case DOPRI54_DONE: return "no reason";
    case DOPRI54_NOT_FINITE: return "a derivative is not finite";
    case DOPRI54_STEP_VANISHED: return "the tolerance needs internal steps below the resolution of time";
    case DOPRI54_TOO_MANY_STEPS: return "too many internal steps (stiff equations, or far too long a step)";
    }
    return "an unknown reason";
}

static fmi2Status check_step(const Instance *instance, double start, double size)
{
    const double time = simulation_time(instance->simulation);
    if (!(size > 0.0 && isfinite(size))) {
        return refuse(instance, fmi2Error, "fmi2DoStep: the communication step size %g is not positive and finite.",
                      size);
    }
    if (!(fabs(start - time) <= time_tolerance(time, size))) {
        return refuse(instance, fmi2Error, "fmi2DoStep: the communication point is %.10g, the instance is at %.10g.",
                      start, time);
    }
    if (start + size > instance->stop_time + time_tolerance(instance->stop_time, size)) {
        return refuse(instance, fmi2Error, "fmi2DoStep: the step ends at %.10g, after the stop time %.10g.",
                      start + size, instance->stop_time);
    }
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    Instance *instance = c;
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!allowed(instance, MODE_STEP_COMPLETE, "fmi2DoStep")) return fmi2Error;
    const fmi2Status checked = check_step(instance, currentCommunicationPoint, communicationStepSize);
    if (checked != fmi2OK) return checked;

    const Advance advance = simulation_advance(instance->simulation, currentCommunicationPoint, communicationStepSize);
    if (advance.result == DOPRI54_DONE) return fmi2OK;
    instance->mode = MODE_ERROR;
    return refuse(instance, fmi2Error, "fmi2DoStep: the integration failed at time %.10g: %s.", advance.time,
                  reason(advance.result));
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    if (!allowed(c, MODE_ANY, "fmi2CancelStep")) return fmi2Error;
    return refuse(c, fmi2Error, "fmi2CancelStep: steps are never pending, there is nothing to cancel.");
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr;
    (void)order;
    (void)value;
    if (!allowed(c, MODE_ANY, "fmi2SetRealInputDerivatives")) return fmi2Error;
    if (nvr == 0) return fmi2OK;
    return refuse(c, fmi2Error, "fmi2SetRealInputDerivatives: inputs are held during a step, not interpolated.");
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr;
    (void)order;
    (void)value;
    if (!allowed(c, MODE_ANY, "fmi2GetRealOutputDerivatives")) return fmi2Error;
    if (nvr == 0) return fmi2OK;
    return refuse(c, fmi2Error, "fmi2GetRealOutputDerivatives: this FMU provides no derivatives of its outputs.");
}

/* The answer to a status that only exists for steps that are pending. */
static fmi2Status never_pending(const Instance *instance, const char *function)
{
    if (!allowed(instance, MODE_ANY, function)) return fmi2Error;
    return refuse(instance, fmi2Discard, "%s: this status is not available, steps are never pending.", function);
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)s;
    (void)value;
    return never_pending(c, "fmi2GetStatus");
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    const Instance *instance = c;
    if (s != fmi2LastSuccessfulTime) return never_pending(instance, "fmi2GetRealStatus");
    if (!allowed(instance, MODE_ANY, "fmi2GetRealStatus")) return fmi2Error;
    if (!present(instance, value, 1, "fmi2GetRealStatus")) return fmi2Error;
    *value = simulation_time(instance->simulation);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s;
    (void)value;
    return never_pending(c, "fmi2GetIntegerStatus");
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    const Instance *instance = c;
    if (s != fmi2Terminated) return never_pending(instance, "fmi2GetBooleanStatus");
    if (!allowed(instance, MODE_ANY, "fmi2GetBooleanStatus")) return fmi2Error;
    if (!present(instance, value, 1, "fmi2GetBooleanStatus")) return fmi2Error;
    *value = fmi2False; /* the model never asks for the end */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s;
    (void)value;
    return never_pending(c, "fmi2GetStringStatus");
}
