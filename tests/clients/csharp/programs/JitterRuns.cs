// Replays a schedule of frames and samples through the jitter buffer.

using System.Collections.Generic;
using Adverb;

static class JitterRuns
{
    internal static object Run(Dictionary<string, object> schedule)
    {
        var lateness = new Lateness();
        var buffer = new JitterBuffer(lateness, schedule["interval_s"].Num()) { Looping = (bool)schedule["looping"] };
        bool weights = (bool)schedule["weights"];
        var pose = new AdverbPose();
        var found = new List<object>();
        foreach (object step in schedule["steps"].List())
        {
            Dictionary<string, object> fields = step.Map();
            switch ((string)fields["do"])
            {
                case "push":
                    lateness.Add(fields["arrived"].Num(), fields["due"].Num());
                    buffer.Push(fields["due"].Num(), Record(fields, weights), (bool)fields["irregular"]);
                    break;
                case "end": buffer.End(); break;
                case "restart": buffer.Restart(); break;
                default: found.Add(buffer.Sample(fields["now"].Num(), pose) ? Row(pose) : null); break;
            }
        }
        return new Dictionary<string, object> { { "samples", found }, { "late", buffer.Late },
        { "duplicates", buffer.Duplicates } };
    }

    static WireRecord Record(Dictionary<string, object> fields, bool weights)
    {
        return new WireRecord
        {
            Encoding = weights ? Encodings.Weights : Encodings.F32,
            Flags = (int)fields["flags"].Num(),
            Version = (uint)fields["version"].Num(),
            Phase = (float)fields["phase"].Num(),
            Time = (float)fields["time"].Num(),
            Duration = (float)fields["duration"].Num(),
            Error = fields["error"] == null ? float.NaN : (float)fields["error"].Num(),
            Values = fields["values"].Singles(),
        };
    }

    static object Row(AdverbPose pose)
    {
        return new Dictionary<string, object>
        {
            { "numbers", new[] { pose.ServerTimeS, pose.Phase, pose.TimeS, pose.DurationS, pose.DelayS,
                pose.ExtrapolatedS } },
            { "error", Fields.Finite(pose.Error) }, { "version", pose.Version },
            { "flags", new[] { pose.Clamped, pose.InTransition, pose.Ended, pose.Held, pose.IsWeights } },
            { "values", (float[])pose.Values.Clone() },
        };
    }
}
