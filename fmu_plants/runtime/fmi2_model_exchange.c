/* FMI 2.0 for Model Exchange (section 3.2). */
#include "fmi2Functions.h"
#include "instance.h"

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    return (fmi2Status)instance_enter_event_mode(c, __func__);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo)
{
    if (!allowed(c, MODE_EVENT, __func__) || !present(c, eventInfo, 1, __func__)) return fmi2Error;
    *eventInfo = (fmi2EventInfo){fmi2False, fmi2False, fmi2False, fmi2False, fmi2False, 0.0};
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return (fmi2Status)instance_enter_continuous_time_mode(c, __func__);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!allowed(c, MODE_CONTINUOUS_TIME, __func__) || !present(c, enterEventMode, 1, __func__) ||
        !present(c, terminateSimulation, 1, __func__)) {
        return fmi2Error;
    }
    *enterEventMode = fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    return (fmi2Status)instance_set_time(c, time, __func__);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    return (fmi2Status)instance_set_states(c, x, nx, __func__);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    return (fmi2Status)instance_get_derivatives(c, derivatives, nx, __func__);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    return (fmi2Status)instance_get_event_indicators(c, eventIndicators, ni, __func__);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    return (fmi2Status)instance_get_states(c, x, nx, __func__);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    return (fmi2Status)instance_get_nominals(c, x_nominal, nx, __func__);
}
