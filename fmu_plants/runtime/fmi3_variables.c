/* FMI 3.0: values of variables (section 2.2.6.2). All variables are scalars of type Float64. */
#include "fmi3Functions.h"
#include "instance.h"

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          fmi3Float64 values[], size_t nValues)
{
    if (!paired(instance, nValueReferences, nValues, __func__)) return fmi3Error;
    return (fmi3Status)instance_get(instance, valueReferences, nValueReferences, values, __func__);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                          const fmi3Float64 values[], size_t nValues)
{
    if (!paired(instance, nValueReferences, nValues, __func__)) return fmi3Error;
    return (fmi3Status)instance_set(instance, valueReferences, nValueReferences, values, __func__);
}

/* Named together in messages, for the size of the library. */
static const char OTHER_TYPES[] = "access to types other than Float64";

/* Both functions of a type that no variable has; twelve types differ in nothing but their names. */
#define NO_VARIABLES_OF_TYPE(Type)                                                                                    \
    fmi3Status fmi3Get##Type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                       \
                             size_t nValueReferences, fmi3##Type values[], size_t nValues)                            \
    {                                                                                                                 \
        (void)valueReferences;                                                                                        \
        (void)values;                                                                                                 \
        (void)nValues;                                                                                                \
        return (fmi3Status)instance_get_other_type(instance, nValueReferences, OTHER_TYPES);                          \
    }                                                                                                                 \
    fmi3Status fmi3Set##Type(fmi3Instance instance, const fmi3ValueReference valueReferences[],                       \
                             size_t nValueReferences, const fmi3##Type values[], size_t nValues)                      \
    {                                                                                                                 \
        (void)valueReferences;                                                                                        \
        (void)values;                                                                                                 \
        (void)nValues;                                                                                                \
        return (fmi3Status)instance_set_other_type(instance, nValueReferences, OTHER_TYPES);                          \
    }

NO_VARIABLES_OF_TYPE(Float32)
NO_VARIABLES_OF_TYPE(Int8)
NO_VARIABLES_OF_TYPE(UInt8)
NO_VARIABLES_OF_TYPE(Int16)
NO_VARIABLES_OF_TYPE(UInt16)
NO_VARIABLES_OF_TYPE(Int32)
NO_VARIABLES_OF_TYPE(UInt32)
NO_VARIABLES_OF_TYPE(Int64)
NO_VARIABLES_OF_TYPE(UInt64)
NO_VARIABLES_OF_TYPE(Boolean)
NO_VARIABLES_OF_TYPE(String)

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return (fmi3Status)instance_get_other_type(instance, nValueReferences, OTHER_TYPES);
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    (void)valueReferences;
    (void)valueSizes;
    (void)values;
    (void)nValues;
    return (fmi3Status)instance_set_other_type(instance, nValueReferences, OTHER_TYPES);
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies)
{
    (void)valueReference;
    (void)nDependencies;
    if (!allowed(instance, MODES_ANY, __func__)) return fmi3Error;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: no dependencies per element, variables are scalars.",
                              __func__);
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies)
{
    (void)dependent;
    (void)elementIndicesOfDependent;
    (void)independents;
    (void)elementIndicesOfIndependents;
    (void)dependencyKinds;
    (void)nDependencies;
    if (!allowed(instance, MODES_ANY, __func__)) return fmi3Error;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: no dependencies per element, variables are scalars.",
                              __func__);
}
