// A recorded stream: joint positions of all records.

using System;
using System.Collections.Generic;
using System.IO;
using System.Text;
using Adverb;

static class ReplayRuns
{
    internal static object Run(string recording, Dictionary<string, object> expected, string root)
    {
        var evaluators = new Dictionary<string, VerbEvaluator>();
        foreach (object each in expected["artifacts"].List())
        {
            Dictionary<string, object> row = each.Map();
            evaluators[row["verb"] + " " + row["version"]] = VerbEvaluator.Load(Path.Combine(root, (string)row["file"]));
        }
        var opened = new Dictionary<int, Dictionary<string, object>>();
        var layouts = new Dictionary<int, WireLayout>();
        var found = new List<object>();
        byte[] content = File.ReadAllBytes(recording);
        for (int at = 0; at < content.Length;)
        {
            int kind = BitConverter.ToInt32(content, at), length = BitConverter.ToInt32(content, at + 4);
            var message = new byte[length];
            Array.Copy(content, at + 8, message, 0, length);
            at += 8 + length;
            if (kind == 1)
            {
                found.Add(Poses(message, layouts, opened, evaluators));
                continue;
            }
            Dictionary<string, object> fields = Json.ParseObject(Encoding.UTF8.GetString(message));
            if ((string)fields["op"] != "opened") continue;
            var channel = (int)fields["channel"].Num();
            opened[channel] = fields;
            layouts[channel] = WireLayout.Of((string)fields["encoding"], fields["joints"].List().Count,
                (int)fields["record_bytes"].Num());
        }
        return found;
    }

    static object Poses(byte[] content, Dictionary<int, WireLayout> layouts,
        Dictionary<int, Dictionary<string, object>> opened, Dictionary<string, VerbEvaluator> evaluators)
    {
        var message = new PoseMessage();
        message.Read(content, content.Length, layouts);
        var rows = new List<object>();
        for (int k = 0; k < message.Count; k++)
        {
            WireRecord record = message[k];
            Dictionary<string, object> channel = opened[record.Channel];
            float[] positions = record.Encoding == Encodings.Weights
                ? Evaluated(evaluators[channel["verb"] + " " + record.Version], record)
                : Positions(SkeletonOf(channel["skeleton"].Map()), record.Values);
            rows.Add(new Dictionary<string, object>
            {
                { "channel", record.Channel }, { "version", record.Version }, { "positions", positions },
            });
        }
        return new Dictionary<string, object> { { "sequence", message.Sequence }, { "records", rows } };
    }

    static float[] Evaluated(VerbEvaluator evaluator, WireRecord record)
    {
        var pose = new EvaluatedPose();
        evaluator.PoseOf(Array.ConvertAll(record.Values, value => (double)value), record.Phase, pose);
        return Positions(evaluator.Skeleton, pose.Values);
    }

    static float[] Positions(Skeleton skeleton, float[] values)
    {
        var positions = new float[3 * skeleton.Names.Length];
        skeleton.Solve(values, positions);
        return positions;
    }

    static Skeleton SkeletonOf(Dictionary<string, object> fields)
    {
        string[] names = fields["names"].List().ConvertAll(name => (string)name).ToArray();
        int[] parents = fields["parents"].List().ConvertAll(parent => (int)parent.Num()).ToArray();
        var offsets = new List<double>();
        foreach (object row in fields["offsets"].List()) offsets.AddRange(row.Nums());
        return new Skeleton(names, parents, offsets.ToArray());
    }
}
