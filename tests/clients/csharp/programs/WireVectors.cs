// Decodes and encodes the messages of tests/golden/wire_vectors.v1.json.

using System.Collections.Generic;
using Adverb;

static class WireVectors
{
    internal static object Run(Dictionary<string, object> vectors)
    {
        return new Dictionary<string, object>
        {
            { "poses", vectors["pose_messages"].List().ConvertAll(Pose) },
            { "malformed", vectors["malformed_pose_messages"].List().ConvertAll(Error) },
            { "layouts", vectors["layouts"].List().ConvertAll(Layout) },
            { "q48", vectors["q48"].Map()["decode"].List().ConvertAll(row => Rotation(1, row.Map()["words"].Nums())) },
            { "q32", vectors["q32"].Map()["decode"].List().ConvertAll(row => Rotation(3, row.Map()["word"].Num())) },
            { "one", vectors["adverb_messages"].List().ConvertAll(One) },
            { "many", vectors["bulk_adverb_messages"].List().ConvertAll(Many) },
            { "clocks", vectors["clocks"].List().ConvertAll(Clock) },
            { "lateness", vectors["jitter"].List().ConvertAll(Late) },
            { "texts", vectors["client_messages"].List().ConvertAll(row =>
                Json.Parse(Json.Write(row.Map()["fields"]))) },
            { "damaged", Damaged(vectors) },
            { "allocated", Allocated(vectors["pose_messages"].List()) },
        };
    }

    static Dictionary<int, WireLayout> Layouts(object vector)
    {
        var found = new Dictionary<int, WireLayout>();
        foreach (KeyValuePair<string, object> each in vector.Map()["layouts"].Map())
            found[int.Parse(each.Key)] = LayoutOf(each.Value);
        return found;
    }

    static WireLayout LayoutOf(object row)
    {
        Dictionary<string, object> fields = row.Map();
        return WireLayout.Of((string)fields["encoding"], (int)fields["joints"].Num(),
            (int)fields["record_bytes"].Num());
    }

    static object Pose(object vector)
    {
        byte[] content = vector.Map()["hex"].Bytes();
        var message = new PoseMessage();
        message.Read(content, content.Length, Layouts(vector));
        var records = new List<object>();
        for (int k = 0; k < message.Count; k++)
        {
            WireRecord record = message[k];
            records.Add(new Dictionary<string, object>
            {
                { "channel", record.Channel }, { "encoding", record.Encoding }, { "flags", record.Flags },
                { "version", record.Version }, { "phase", record.Phase }, { "time", record.Time },
                { "error", Fields.Finite(record.Error) }, { "duration", record.Duration }, { "values", record.Values },
            });
        }
        return new Dictionary<string, object>
        {
            { "sequence", message.Sequence }, { "dropped", message.Dropped }, { "time_ns", message.TimeNs.ToString() },
            { "records", records },
        };
    }

    static object Error(object vector)
    {
        byte[] content = vector.Map()["hex"].Bytes();
        try
        {
            new PoseMessage().Read(content, content.Length, Layouts(vector));
            return null;
        }
        catch (AdverbException error)
        {
            return error.Code;
        }
    }

    static object Layout(object row)
    {
        try
        {
            return LayoutOf(row).RecordBytes;
        }
        catch (AdverbException)
        {
            return null;
        }
    }

    /// <summary>A record of one joint with given words.</summary>
    static object Rotation(int encoding, params double[] words)
    {
        var content = new byte[20 + 44];
        content[0] = content[1] = content[2] = 1;
        content[22] = (byte)encoding;
        for (int k = 0; k < words.Length; k++)
            for (int b = 0; b < (encoding == 1 ? 2 : 4); b++)
                content[20 + 36 + (encoding == 1 ? 2 : 4) * k + b] = (byte)((long)words[k] >> 8 * b);
        var layout = new WireLayout(encoding, 1);
        var message = new PoseMessage();
        message.Read(content, 20 + layout.RecordBytes, new Dictionary<int, WireLayout> { { 0, layout } });
        return new List<float>(message[0].Values).GetRange(3, 4);
    }

    static object One(object vector)
    {
        Dictionary<string, object> fields = vector.Map();
        return Wire.EncodeAdverbs((int)fields["channel"].Num(), fields["adverbs"].Singles()).Hex();
    }

    static object Many(object vector)
    {
        Dictionary<string, object> fields = vector.Map();
        var rows = new List<float>();
        foreach (object row in fields["adverbs"].List()) rows.AddRange(row.Singles());
        return Wire.EncodeAdverbs(fields["channels"].List().ConvertAll(each => (int)each.Num()), rows.ToArray()).Hex();
    }

    static object Clock(object vector)
    {
        var clock = new ServerClock();
        foreach (object ping in vector.Map()["pings"].List())
            clock.Add(ping.Map()["sent_s"].Num(), ping.Map()["arrived_s"].Num(),
                long.Parse((string)ping.Map()["server_time_ns"]));
        return new[] { clock.OffsetS, clock.RoundTripS };
    }

    static object Late(object vector)
    {
        var lateness = new Lateness();
        foreach (object row in vector.Map()["arrived_due_s"].List())
            lateness.Add(row.List()[0].Num(), row.List()[1].Num());
        double smallest, late;
        lateness.Measure(out smallest, out late);
        return new[] { smallest, late, new JitterBuffer(lateness, vector.Map()["interval_s"].Num()).DelayS };
    }

    /// <summary>
    /// Number of rejected messages out of 20,000 poses and 20,000 texts with changed bytes. Other errors than AdverbException
    /// end the program.
    /// </summary>
    static object Damaged(Dictionary<string, object> vectors)
    {
        var random = new System.Random(11);
        var poses = vectors["pose_messages"].List().ConvertAll(row => row.Map()["hex"].Bytes());
        var layouts = vectors["pose_messages"].List().ConvertAll(Layouts);
        var texts = vectors["server_messages"].List().ConvertAll(row => (string)row.Map()["text"]);
        var message = new PoseMessage();
        int rejected = 0;
        for (int k = 0; k < 40000; k++)
        {
            int which = random.Next(k % 2 == 0 ? poses.Count : texts.Count);
            byte[] content = k % 2 == 0 ? (byte[])poses[which].Clone() : System.Text.Encoding.UTF8.GetBytes(texts[which]);
            for (int n = random.Next(1, 4); n > 0; n--) content[random.Next(content.Length)] = (byte)random.Next(256);
            int length = random.Next(4) == 0 ? random.Next(content.Length) : content.Length;
            try
            {
                if (k % 2 == 0) message.Read(content, length, layouts[which]);
                else Json.ParseObject(System.Text.Encoding.UTF8.GetString(content, 0, length));
            }
            catch (AdverbException)
            {
                rejected++;
            }
        }
        return rejected;
    }

    /// <summary>Bytes that decoding and display of 20,000 messages allocate, once arrays have their sizes.</summary>
    static object Allocated(List<object> vectors)
    {
        var contents = vectors.ConvertAll(vector => vector.Map()["hex"].Bytes());
        var layouts = vectors.ConvertAll(Layouts);
        int which = contents.FindIndex(content => content.Length > 200);
        var message = new PoseMessage();
        var lateness = new Lateness();
        var buffer = new JitterBuffer(lateness, 1.0 / 60.0);
        var pose = new AdverbPose();
        long before = 0;
        for (int k = 0; k < 20200; k++)
        {
            if (k == 200)
            {
                System.GC.Collect();
                before = System.GC.GetTotalMemory(true);
            }
            message.Read(contents[which], contents[which].Length, layouts[which]);
            lateness.Add(k / 60.0 + 0.01, k / 60.0);
            buffer.Push(k / 60.0, message[0]);
            buffer.Sample(k / 60.0 + 0.02, pose);
        }
        return System.GC.GetTotalMemory(false) - before;
    }
}
